"""interim"""


def train() -> None:
    """Interim."""
