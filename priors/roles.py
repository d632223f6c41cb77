"""Which of the priors does what the library itself needs one for."""

FIRST = "pose"
"""Name of the prior that finds first motions: it does not ask where the ground is."""
