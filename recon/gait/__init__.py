"""Gait as laboratories read it: events, cycles, joint angles and their report."""
