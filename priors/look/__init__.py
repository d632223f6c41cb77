"""A network that proposes whole motions of a clip from some points of the body in space."""
