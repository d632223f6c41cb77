"""The public functions: observations or files in, a result out. `recon` exports them all."""
