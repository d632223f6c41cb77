"""Fits or converts many clips in parallel processes, with logs to resume from."""
