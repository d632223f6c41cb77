"""Training of the prior `anchor` of whole gait cycles (after Marsot et al. 2022)."""
