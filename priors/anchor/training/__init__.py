"""Training of the anchor-frame prior's weights."""
