"""A public benchmark of methods on the same windows of freely licensed motions."""
