"""How the weights of the HUMOS prior are made."""
