"""Paths of the priors' weights; quick to import, unlike the priors."""

from importlib.util import find_spec
from pathlib import Path


def weights_path(name: str | Path, kind: str) -> Path:
    """The weights file of a prior, of the set `open` or `nc`; any other name is a path.

    The `nc` weights lie in a source checkout and not in the package, since their licence
    (CC BY-NC 4.0) is another.
    """
    if name not in ("open", "nc"):
        return Path(name)
    found = find_spec("priors")
    assert found is not None  # both packages are installed together
    assert found.origin is not None
    package, file = Path(found.origin).parent, f"{kind}.safetensors"
    return package / "weights" / file if name == "open" else package.parent / "weights-nc" / file
