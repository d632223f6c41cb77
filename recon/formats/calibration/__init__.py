"""Camera calibrations of several programs; `cameras` tells by what a file holds."""
