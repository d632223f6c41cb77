"""Kept for plug-ins of version 0.2.0, which import the base class of sensors from here."""
