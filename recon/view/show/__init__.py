"""What is shown, as values: figures, points, cameras, viewpoints."""
