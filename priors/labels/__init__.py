"""A network that tells which part of a body each point of a cloud lies on, and where."""
