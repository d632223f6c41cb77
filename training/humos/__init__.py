"""Training of HUMOS (Tripathi et al. 2024)."""
