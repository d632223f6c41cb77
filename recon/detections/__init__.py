"""2D keypoints as detectors write them; `reader` chooses the format by a file's content."""
