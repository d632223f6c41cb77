"""L-BFGS over batches of independent problems: tensors only, nothing of people."""
