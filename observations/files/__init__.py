"""Observations from the content of files."""
