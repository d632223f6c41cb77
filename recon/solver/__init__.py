"""L-BFGS over batches, damped Gauss-Newton over sequences: tensors, nothing of people."""
