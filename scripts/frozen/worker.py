"""Runs cases with the checkout that comes first in PYTHONPATH.

Reads lines of JSON from stdin, {"inputs": FOLDER} to write the inputs, {"case": NAME, "inputs":
FOLDER, "out": FILE} to run a case or {"verb": NAME, "files": PATHS, "how": OPTIONS, "out": PATH}
to call a function of recon and save its result, and answers each with a line of JSON.
"""

import json
import os
import shutil
import subprocess
import sys
import traceback
from pathlib import Path
from typing import Any

import numpy as np
import torch

import recon
from scripts.frozen.cases import CASES, streamed
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
    """Carry out a request; return CPU seconds of this process and those that it started."""
    torch.manual_seed(0)
    before = sum(os.times()[:4])
    if "verb" in asked:
        return {"seconds": called(**asked)}
    inputs = Path(asked["inputs"])
    if "case" not in asked:
        make_inputs(inputs)
        return {"seconds": sum(os.times()[:4]) - before}
    arrays = CASES[asked["case"]](inputs)
    seconds = sum(os.times()[:4]) - before
    np.savez_compressed(asked["out"], **arrays)
    return {"seconds": seconds}


def called(verb: str, files: list[str], how: dict[str, Any], out: str) -> float:
    """Call a function of recon on files and save its result; return CPU seconds."""
    before = sum(os.times()[:4])
    if verb == "stream":
        np.savez(out, joints=streamed(Path(files[0]), **how))
    elif verb == "batch":
        shutil.rmtree(out, ignore_errors=True)
        command = [sys.executable, "-P", "-m", "recon", "batch", *files, "--out", out, "--quiet"]
        subprocess.run(command, stdout=sys.stderr, check=True)
    elif verb in ("fit", "complete"):
        getattr(recon, verb)(recon.load_observation(files), **how).save(out, overwrite=True)
    else:
        getattr(recon, verb)(*files, **how).save(out, overwrite=True)
    return sum(os.times()[:4]) - before


if __name__ == "__main__":
    main()
