"""Steps of `scripts/build_body.py`: from MakeHuman's adults to the bundled linear body."""
