"""Reads 3D keypoints of many programs; `reader` recognises the format."""
