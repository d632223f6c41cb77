"""Training of the anchor-frame VAE of gait cycles (Marsot et al. 2022)."""
