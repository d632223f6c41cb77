"""Results on disk: where they may be written, and how, beside their reports."""
