"""How the weights are made: one readable file per prior."""
