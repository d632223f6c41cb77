"""Geometry without people: planes, normals, neighbours, triangles to pixels."""
