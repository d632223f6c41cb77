"""Compatibility with plug-ins of version 0.2.0: sensor clocks are now in `recon.method.timing`."""

from recon.method.timing import at_observation_times, moment_numbers, padded

__all__ = ["at_observation_times", "moment_numbers", "padded"]
