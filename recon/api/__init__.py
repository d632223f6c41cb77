"""The public functions: observations or files in, a result out; all are names of `recon`."""
