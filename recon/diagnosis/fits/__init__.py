"""Checks of a fit: residuals, what was seen, whether result and data agree."""
