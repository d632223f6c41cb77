"""Training of the priors from a converted corpus; in no wheel."""
