"""Writes motions in the formats of other programs."""
