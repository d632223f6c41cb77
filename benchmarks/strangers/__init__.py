"""Leave-one-person-out: what the priors are worth to people whom they never saw."""
