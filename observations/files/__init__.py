"""From what files hold to observations."""
