"""Clocks of scans and clouds: recorded times, and the frames that they make."""
