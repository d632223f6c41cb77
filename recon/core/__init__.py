"""Values that everything else speaks in: motions, rotations, cameras, grounds, units."""
