"""Model files of MediaPipe, for the detectors of people and hands of `motion-recon`."""

from pathlib import Path

FOLDER = Path(__file__).parent
"""Where the files are."""
