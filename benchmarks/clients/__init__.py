"""Runs the programs that read our files on them: Blender, three.js, OpenSim, USD and others."""
