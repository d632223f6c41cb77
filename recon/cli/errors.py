"""The exception with which a verb reports a failure."""


class Failed(Exception):
    """The work could not be finished though the input was good; exit code 1."""
