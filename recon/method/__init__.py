"""How a fit is put together and run: protocols, terms, stages and their loop."""
