"""The base of sensors under the name that plug-ins of 0.2.0 derive from."""

from recon.method.sensor import Sensor as SensorRecord

__all__ = ["SensorRecord"]
