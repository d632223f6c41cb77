"""The base class of sensors under its name in version 0.2.0."""

from recon.method.sensor import Sensor as SensorRecord

__all__ = ["SensorRecord"]
