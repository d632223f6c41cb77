"""HUMOS judged alone: what its network adds to a scaled copy, to physics and to fits."""
