"""Weights files: a checksum over tensors and settings, checked when they are read."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from priors.checkpoints import load_checkpoint, named_checkpoint
from recon.formats.replacing import file_checksum
from scripts.sign_weights import sign
from training.weights import save_checkpoint

ROOT = Path(__file__).parents[2]
SHIPPED = [*(ROOT / "priors/weights").glob("*.safetensors")]
TENSORS = {
    "net.0.weight": torch.arange(12.0).reshape(3, 4),
    "net.0.bias": torch.tensor([1.0, -2.0, 0.5]).half(),
    "indices": torch.tensor([1, 2, 3]),
    "scale": torch.tensor(2.5),
}


def test_flipped_bits_are_refused(tmp_path: Path) -> None:
    """Weights with flipped bits were read, and everything after them was wrong by a little."""
    path = tmp_path / "w.safetensors"
    save_checkpoint(path, "net", TENSORS, {"width": 3, "rate": 0.1, "pair": (1, 2)})
    back = load_checkpoint(path, "net")
    assert back.settings == {"width": 3, "rate": 0.1, "pair": [1, 2]}
    assert all(torch.equal(back.tensors[name], tensor) for name, tensor in TENSORS.items())
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    body = len(data) - sum(t.nbytes for t in TENSORS.values())
    for place in (*range(body, len(data)), *rng.integers(0, body, 60).tolist()):
        changed = bytearray(data)
        changed[place] ^= 1 << int(rng.integers(0, 8))
        path.write_bytes(changed)
        refused = ""
        try:
            back = load_checkpoint(path, "net")
        except ValueError as error:
            refused = str(error)
        if place >= body or refused:
            assert "w.safetensors" in refused, place
        else:  # spaces of the header, or the word sha256
            assert all(torch.equal(back.tensors[k], tensor) for k, tensor in TENSORS.items())


@pytest.mark.parametrize("shipped", SHIPPED, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_shipped_weights_carry_their_checksum(shipped: Path, tmp_path: Path) -> None:
    """Labels and stiffness of steps, and the weights that are not commercial, were not asked."""
    path = tmp_path / "w.safetensors"
    shutil.copy(shipped, path)
    assert sign(path) == "has the right checksum"
    assert shipped.with_suffix(".md").is_file()


def test_every_kind_of_weights_is_shipped() -> None:
    kinds = {"pose", "humor", "humor_steps", "anchor", "humos", "labels", "look"}
    assert {path.stem for path in SHIPPED} == kinds
    assert named_checkpoint("open", "humor").path in SHIPPED


def test_the_mean_hessian_of_steps_was_made_of_the_shipped_networks_and_poses() -> None:
    made_of = named_checkpoint("open", "humor_steps").settings["made_of"]
    shipped = {path.stem: path for path in SHIPPED if path.parent.name == "weights"}
    assert made_of == {kind: file_checksum(shipped[kind]) for kind in ("humor", "pose")}


def test_files_without_a_checksum_are_read_and_can_be_signed(tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    about = json.dumps({"kind": "net", "settings": {"width": 3}})
    save_file(TENSORS, path, metadata={"recon": about})
    assert load_checkpoint(path, "net").settings == {"width": 3}
    assert sign(path) == "checksum added"
    assert sign(path) == "has the right checksum"
    assert all(
        torch.equal(load_checkpoint(path, "net").tensors[k], value) for k, value in TENSORS.items()
    )
    for bad in (np.nan, 1e30):
        save_file({"weight": torch.tensor([bad])}, path, metadata={"recon": about})
        with pytest.raises(ValueError, match=r"w\.safetensors.*weight"):
            load_checkpoint(path, "net")


def test_damaged_metadata(tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    for about in ("[" * 100_000, "{", "1" * 5000, '{"kind": "net", "settings": 3}'):
        save_file(TENSORS, path, metadata={"recon": about})
        with pytest.raises(ValueError, match=r"w\.safetensors"):
            load_checkpoint(path, "net")
