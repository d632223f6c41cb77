"""Places of the weights of every prior; light to import, unlike the priors themselves."""

from importlib.util import find_spec
from pathlib import Path


def weights_path(name: str | Path, kind: str) -> Path:
    """The file of the weights of this kind: `open`, `nc`, or else the name is the path itself.

    The `nc` weights lie in a source checkout and not in the package, since their licence
    (CC BY-NC 4.0) is another.
    """
    if name not in ("open", "nc"):
        return Path(name)
    found = find_spec("priors")
    assert found is not None  # `priors` is installed together with this package
    assert found.origin is not None
    package, file = Path(found.origin).parent, f"{kind}.safetensors"
    return package / "weights" / file if name == "open" else package.parent / "weights-nc" / file
