"""Training of the network that proposes whole motions (`priors.look`)."""
