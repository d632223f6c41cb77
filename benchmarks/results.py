"""What every table's JSON says about itself: command, seed, versions, machine."""

import json
import os
import platform
from pathlib import Path
from typing import Any

import numpy as np
import torch

from recon import __version__
from recon.formats.files import replacing


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
