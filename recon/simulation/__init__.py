"""Known motions as sensors would have seen them."""
