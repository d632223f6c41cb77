"""What laws of movement say: gravity, gait, treadmills, what carries the feet."""
