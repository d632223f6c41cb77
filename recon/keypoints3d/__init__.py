"""3D keypoints as producers write them; `reader` chooses the format by a file's content."""
