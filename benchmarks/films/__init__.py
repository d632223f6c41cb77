"""Films: real ones against calibrated views, and rendered ones against the truth."""
