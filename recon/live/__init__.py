"""Live reconstruction: fixed-lag smoothing, frame by frame."""
