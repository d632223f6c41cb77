"""Motions that other programs estimated: what in them is to be believed."""
