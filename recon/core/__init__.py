"""Basic types used everywhere: motions, rotations, cameras, grounds, units."""
