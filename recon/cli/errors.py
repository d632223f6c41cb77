"""The exception by which a command reports that its work failed."""


class Failed(Exception):
    """The work of a command failed although its input was good; exit code 1."""
