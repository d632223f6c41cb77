"""Kept for plug-ins of version 0.2.0: clocks of sensors, now in `recon.method.timing`."""

from recon.method.timing import at_observation_times, moment_numbers, padded

__all__ = ["at_observation_times", "moment_numbers", "padded"]
