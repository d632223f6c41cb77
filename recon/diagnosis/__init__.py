"""Checks of a recording before a fit, and of residuals and motion after it."""
