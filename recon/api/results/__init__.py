"""What functions of `recon` return: motions, metrics and observations that print and save."""
