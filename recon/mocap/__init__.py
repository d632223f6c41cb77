"""Reads motion-capture files (BVH, ASF/AMC, C3D, TRC, .mat); `reader` chooses by suffix."""
