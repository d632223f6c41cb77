"""Motions that nobody recorded, made of recorded windows: what may be edited, and how."""
