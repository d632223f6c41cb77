"""Gait analysis as laboratories do it: events, cycles, joint angles and their report."""
