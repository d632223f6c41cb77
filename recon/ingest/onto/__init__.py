"""Motions of one body brought onto another one's mesh, which has other vertices and shapes."""
