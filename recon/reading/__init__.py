"""Reading of files of any kind: observations of one clip, or a motion."""
