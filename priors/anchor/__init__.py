"""The anchor-frame prior: a whole cycle of gait as one latent code (Marsot et al. 2022)."""
