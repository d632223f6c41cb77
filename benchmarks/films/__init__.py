"""Compares fits of films with the truth: real films with calibrated views, and rendered films."""
