"""Training of HuMoR (Rempe et al. 2021)."""
