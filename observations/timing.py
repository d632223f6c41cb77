"""Clocks of sensors, at the place where 0.2.0 had them; they are in `recon.method.timing`."""

from recon.method.timing import at_observation_times, moment_numbers, padded

__all__ = ["at_observation_times", "moment_numbers", "padded"]
