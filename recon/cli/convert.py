"""`recon convert`: any mocap recording onto the body."""

from pathlib import Path

from tyro.conf import Positional


def convert(
    recording: Positional[Path],
    out: Positional[Path],
) -> None:
    """Interim."""
    raise NotImplementedError
