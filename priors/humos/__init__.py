"""The HUMOS prior.

Windows of motion as latent codes, decoded for the shape of the body that moves.
"""
