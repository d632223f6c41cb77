"""What tables share: the bundled clip, a plain table, and what JSON says about itself."""

import json
import os
import platform
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

import recon
from recon import __version__
from recon.formats.amass import load_motion
from recon.formats.files import replacing
from recon.motion import Motion


def demo_clip(frames: int) -> Motion:
    """The first frames of the bundled demo, at 30 Hz."""
    demo = Path(recon.__file__).parent / "assets" / "demo.npz"
    return load_motion(demo).motion.resample(30.0).window(0, frames)


def show(title: str, rows: dict[str, float]) -> None:
    """Print one value a line."""
    table = Table("what", "value", title=title)
    for name, value in rows.items():
        table.add_row(name, f"{value:.4g}")
    Console().print(table)


def write(path: Path, command: str, seed: int | None, **tables: Any) -> None:
    """Write one run in one step."""
    about = {
        "command": command,
        "seed": seed,
        "recon": __version__,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": np.__version__,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
    }
    with replacing(path) as beside:
        beside.write_text(json.dumps({"about": about, **tables}, indent=1) + "\n")
