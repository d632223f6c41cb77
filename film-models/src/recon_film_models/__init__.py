"""Model files of MediaPipe's BlazePose, for the detector of `motion-recon`."""

from pathlib import Path

FOLDER = Path(__file__).parent
"""Where the files are: `pose_detection.tflite` and `pose_landmark_full.tflite`."""
