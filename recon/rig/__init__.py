"""Depth cameras that nobody calibrated to each other, brought into one frame by what they saw."""
