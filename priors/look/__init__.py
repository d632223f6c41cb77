"""A network that proposes whole motions from the points of a clip that were seen."""
