"""First guesses from one sensor: the rest body placed on its data."""
