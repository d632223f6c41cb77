"""Metrics: errors of a result against the truth, and measures of generated motions."""
