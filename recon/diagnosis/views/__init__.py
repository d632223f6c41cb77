"""Checks of keypoints in images before a fit, and the repairs that are sure."""
