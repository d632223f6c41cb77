"""What kinds of sensors have in common, to derive a sensor from."""
