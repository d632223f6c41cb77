"""Runs cases with the checkout that comes first in PYTHONPATH.

Reads lines of JSON from stdin, {"inputs": FOLDER} to write the inputs or {"case": NAME, "inputs":
FOLDER, "out": FILE} to run a case, and answers each with a line of JSON.
"""

import json
import os
import sys
import traceback
from pathlib import Path
from typing import Any

import numpy as np
import torch

import recon
from scripts.frozen.cases import CASES
from scripts.frozen.inputs import make_inputs


def main() -> None:
    answers, sys.stdout = sys.stdout, sys.stderr
    torch.set_num_threads(1)
    print(json.dumps({"recon": recon.__file__, "cases": list(CASES)}), file=answers, flush=True)
    for line in sys.stdin:
        try:
            said = _answer(json.loads(line))
        except Exception:
            said = {"error": traceback.format_exc()}
        print(json.dumps(said), file=answers, flush=True)


def _answer(asked: dict[str, Any]) -> dict[str, Any]:
    """CPU seconds of this process and of those that it started."""
    torch.manual_seed(0)
    before, inputs = sum(os.times()[:4]), Path(asked["inputs"])
    if "case" not in asked:
        make_inputs(inputs)
        return {"seconds": sum(os.times()[:4]) - before}
    arrays = CASES[asked["case"]](inputs)
    seconds = sum(os.times()[:4]) - before
    np.savez_compressed(asked["out"], **arrays)
    return {"seconds": seconds}


if __name__ == "__main__":
    main()
