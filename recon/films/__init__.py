"""Films: decoding of video files, and detection of people in their frames."""
