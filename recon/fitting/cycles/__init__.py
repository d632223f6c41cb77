"""Cycles of gait completed from sparse data: many beginnings, the best fit of all."""
