"""The laboratory report: one page with figures of gait, and a table beside it."""
