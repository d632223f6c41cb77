"""Recorded markers: which they are, what is wrong with them, the solve."""
