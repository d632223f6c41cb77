"""How a verb says that it failed."""


class Failed(Exception):
    """The work could not be finished though the input was good; exit code 1."""
