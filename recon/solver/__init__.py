"""Solvers for any problem in tensors: L-BFGS for batches, damped Gauss-Newton for sequences."""
