"""HuMoR's decoder, rolled out over time, and its derivative."""
