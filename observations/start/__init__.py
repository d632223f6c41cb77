"""First guesses from one sensor: the rest body laid on what it saw."""
