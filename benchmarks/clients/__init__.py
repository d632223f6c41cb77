"""The programs that our files are for, run on them: Blender, three.js, OpenSim, USD and others."""
