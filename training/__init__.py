"""Training of the priors from a converted corpus; not a part of the installed package."""
