"""2D keypoints as detectors write them; `reader` tells by what a file holds."""
