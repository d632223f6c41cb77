"""Adds the checksum to weights files that have none; the tensors stay as they are, bit for bit.

    python -m scripts.sign_weights priors/weights/*.safetensors

Files that have a checksum are only checked.
"""

import argparse
import json
from pathlib import Path

import torch
from safetensors import safe_open

from priors.checkpoints import load_checkpoint
from training.weights import save_checkpoint


def main() -> None:
    """Sign or check every file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    for path in parser.parse_args().files:
        print(f"{path}: {sign(path)}")


def sign(path: Path) -> str:
    """Add or check the checksum of one file; return what was done.

    Raises:
        ValueError: when it is no weights file, its checksum is wrong, or a tensor changed.
    """
    with safe_open(path, framework="pt") as file:
        about = json.loads((file.metadata() or {}).get("recon", "{}"))
    old = load_checkpoint(path, about.get("kind"))
    if "sha256" in about:
        return "has the right checksum"
    # cloned, since the file is replaced while its tensors are mapped into memory
    tensors = {name: tensor.clone() for name, tensor in old.tensors.items()}
    save_checkpoint(path, about["kind"], tensors, old.settings)
    new = load_checkpoint(path, about["kind"])
    if (new.tensors.keys(), new.settings) != (tensors.keys(), old.settings) or not all(
        torch.equal(tensors[name], new.tensors[name]) for name in tensors
    ):
        raise ValueError(f"{path}: the file written differs from the one read")
    return "checksum added"


if __name__ == "__main__":
    main()
