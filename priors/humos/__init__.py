"""The HUMOS prior: stretches of motion as codes, for the body that moves."""
