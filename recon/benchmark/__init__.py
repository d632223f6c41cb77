"""A neutral benchmark: the same windows of free motions for everybody's method."""
