"""How the weights of the anchor-frame prior are made."""
