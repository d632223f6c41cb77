"""What all observations of a clip say together: a first guess, their weights."""
