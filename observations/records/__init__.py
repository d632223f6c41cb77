"""The place where plug-ins of 0.2.0 find what they derive a sensor from."""
