"""Fits of motions to observations: clips, long recordings, the ground, cycles, other bodies."""
