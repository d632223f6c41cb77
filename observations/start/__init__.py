"""First guesses of a motion from the data of one sensor, by aligning the rest body."""
