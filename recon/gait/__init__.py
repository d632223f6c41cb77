"""Analyses gait as laboratories do: events, cycles, joint angles, and a report of them."""
