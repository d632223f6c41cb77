"""Training of the network that labels points of clouds."""
