"""Errors that refuse input: all are `ValueError`s whose message says what to do."""


class ReconError(ValueError):
    """Something that was given to recon cannot be used."""


class FormatError(ReconError):
    """A file cannot be read as what it should be."""


class UnitsError(ReconError):
    """Numbers are in another unit than the one that is expected."""


class ObservationError(ReconError):
    """An observation is damaged, or does not fit the others."""


class WeightsError(ReconError):
    """A prior does not exist, or its weights cannot be used."""
