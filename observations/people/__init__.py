"""People in detections of 2D keypoints: who is who over frames and views, which camera saw it."""
