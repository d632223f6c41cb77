"""3D keypoints as producers write them; `reader` tells by what a file holds."""
