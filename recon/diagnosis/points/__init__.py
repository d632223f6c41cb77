"""Checks of points in space before a fit, and the repairs that are sure."""
