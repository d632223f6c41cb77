"""Leave-one-person-out tests: what the priors are worth for people whom they never saw."""
