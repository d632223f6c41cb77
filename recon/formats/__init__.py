"""What files hold: motions, observations, and a room for each kind of other."""
