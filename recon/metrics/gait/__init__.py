"""Gait as laboratories measure it: events, cycles, and the figures of time and space."""
