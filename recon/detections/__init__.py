"""Reads 2D keypoints of many detectors; `reader` recognises the format."""
