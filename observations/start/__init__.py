"""First guesses from the data of one sensor: the rest body aligned with them."""
