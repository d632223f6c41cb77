"""Training of the HUMOS prior's weights."""
