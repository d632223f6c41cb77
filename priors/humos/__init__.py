"""The HUMOS prior, whose latent codes describe motions for bodies of any shape.

Windows of motion as latent codes, decoded for the shape of the body that moves.
"""
