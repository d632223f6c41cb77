"""Fits motions to observations: clips, long recordings, grounds, gait cycles, other bodies."""
