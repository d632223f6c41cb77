"""Reads files of any kind as the observations of one clip, or as a motion."""
