"""How near a result is to the truth, and how good generated motions are."""
