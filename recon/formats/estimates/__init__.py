"""Motions that other programs estimated: SMPL-like parameters, frame by frame."""
