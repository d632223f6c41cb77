"""A person while being recorded: fixed-lag smoothing, moment by moment."""
