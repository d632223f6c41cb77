"""Where results may be written, and how they are, beside their reports."""
