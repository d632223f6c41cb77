"""From observations to a motion: clips, long recordings, the ground, cycles, other bodies."""
