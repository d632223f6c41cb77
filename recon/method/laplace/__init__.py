"""How sure a fit is, from the curvature of its objective about the result (Laplace)."""
