"""The exception by which a command reports that its work failed."""


class Failed(Exception):
    """The work failed although the input was good; exit code 1."""
