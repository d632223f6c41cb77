"""Fits that run side by side and share their minimisations, as one batch of the solver."""
