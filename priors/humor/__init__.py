"""HuMoR: a density of every step from one pose to the next (Rempe et al. 2021)."""
