"""Many clips at once: processes, logs by which a run is resumed, whole corpora."""
