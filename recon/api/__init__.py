"""The public functions, from observations or files to results; `import recon` has them all."""
