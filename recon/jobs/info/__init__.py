"""What a file holds, and what was assumed in reading it."""
