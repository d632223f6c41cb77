"""Labels: which part of a body every point of a cloud shows, and where on its surface it lies."""
