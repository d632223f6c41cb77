"""Intervals of means over windows: those of `recon bench`."""

from recon.metrics.intervals import DRAWS as DRAWS
from recon.metrics.intervals import LEVEL as LEVEL
from recon.metrics.intervals import Interval as Estimate  # noqa: F401
from recon.metrics.intervals import interval as interval
from recon.metrics.intervals import paired as paired
