"""Training of HuMoR's weights."""
