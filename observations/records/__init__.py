"""Compatibility: plug-ins written for version 0.2.0 import the base class of sensors from here."""
