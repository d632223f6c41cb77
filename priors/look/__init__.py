"""A network that looks at the points seen of a clip and proposes whole motions."""
