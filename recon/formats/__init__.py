"""Readers and writers of files of motions, observations, cameras and bodies."""
