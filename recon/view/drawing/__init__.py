"""How a frame becomes a picture, on the processor."""
