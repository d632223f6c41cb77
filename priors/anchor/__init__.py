"""The anchor-frame prior: a whole cycle of gait as one code (Marsot et al. 2022)."""
