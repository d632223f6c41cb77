"""The pose prior: single poses and smoothness (stages 1 and 2 of HuMoR)."""
