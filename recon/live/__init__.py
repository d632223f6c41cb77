"""A person while being recorded: fixed-lag smoothing, frame by frame."""
