"""Recordings of motion capture (BVH, ASF/AMC, C3D, TRC, .mat); `reader` tells by suffix."""
