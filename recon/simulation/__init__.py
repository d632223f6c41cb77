"""Simulates what sensors observe of known motions."""
