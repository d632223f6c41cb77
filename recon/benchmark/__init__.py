"""A public benchmark: every method gets the same windows of freely licensed motions."""
