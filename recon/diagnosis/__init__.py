"""What is wrong with a recording: checks before a fit, and what residuals say after it."""
