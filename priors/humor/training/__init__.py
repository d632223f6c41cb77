"""How HuMoR's weights are made."""
