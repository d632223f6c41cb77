"""HuMoR: every step from pose to pose (Rempe et al. 2021)."""
