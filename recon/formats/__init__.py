"""Readers and writers of files: motions, observations, and a folder for each kind of producer."""
