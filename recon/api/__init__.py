"""The front door: observations or files in, a result out. `import recon` has all its names."""
