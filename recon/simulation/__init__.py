"""Simulated observations of known motions."""
