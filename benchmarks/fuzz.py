"""Five hundred spoilt observation files through the command line.

    python -m benchmarks.fuzz --count 500 --seed 0 --json fuzz.json

Each file is made from the bundled clip: 0-95 % of its points missing, up to 40 % of them wild,
NaN or infinity in it, a single frame, a still person, millimetres, y up, truncated, hostile.
Asked of every one: no traceback; exit code 0 and a finite motion, or 1 and a finite motion, or 2,
a message that names the file, and nothing written.
"""

import argparse
import contextlib
import io
import pickle
import tempfile
import traceback
import zipfile
from collections import Counter
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from benchmarks.results import write
from recon import cli
from recon.api.simulate import simulate
from recon.formats.motions import load_motion
from recon.simulation.points import Corruption

Arrays = dict[str, np.ndarray]
Random = np.random.Generator


def main() -> None:
    """Spoil, fit, judge, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    verdicts: Counter[tuple[str, str]] = Counter()
    faults: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(arguments.count):
            random = np.random.default_rng([arguments.seed, number])
            name = list(SPOILS)[number % len(SPOILS)]
            verdict = judge(name, Path(folder), random)
            verdicts[name, verdict] += 1
            if verdict.startswith("FAULT"):
                faults.append(f"file {number} ({name}): {verdict}")
    report(verdicts, faults)
    if arguments.json is not None:
        rows = {f"{name}: {verdict}": count for (name, verdict), count in verdicts.items()}
        write(arguments.json, arguments.seed, rows=rows, faults=faults)


def judge(name: str, folder: Path, random: Random) -> str:
    """What became of one file."""
    seen, out = folder / "observation.npz", folder / "motion.npz"
    for path in (out, out.with_name("motion.npz.json")):
        path.unlink(missing_ok=True)
    kind = "joints3d" if random.random() < 0.5 else "markers3d"
    first = int(random.integers(0, 80))
    corruption = Corruption(
        noise=float(random.choice([0.0, 0.02, 0.04])),
        missing_points=float(random.uniform(0, 0.95)) if name == "missing" else 0.1,
        missing_frames=float(random.choice([0.0, 0.5])) if name == "missing" else 0.0,
        outliers=float(random.uniform(0, 0.4)) if name == "outliers" else 0.0,
    )
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as truth:
        frames = (first, first + 30)
        known = simulate(truth, kind, **vars(corruption), seed=first, frames=frames)
        known.save(seen, overwrite=True)
    SPOILS[name](seen, random)
    errors, answers = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(answers):
            code = cli.run(["fit", str(seen), "--out", str(out)])
    except (Exception, SystemExit):
        return "FAULT: " + traceback.format_exc().splitlines()[-1]
    if code == cli.BAD_INPUT:
        if out.exists():
            return "FAULT: refused, but a motion was written"
        if "observation.npz" not in errors.getvalue():
            return f"FAULT: refused without naming the file: {errors.getvalue()}"
        return "refused by name (2)"
    if code not in (cli.OK, cli.FAILED) or not out.exists():
        return f"FAULT: exit code {code}, motion written: {out.exists()}"
    motion = load_motion(out).motion
    if not all(t.isfinite().all() for t in (motion.translation, motion.rotations, motion.shape)):
        return "FAULT: NaN or infinity in the motion"
    return "fitted (0)" if code == cli.OK else "failed, last estimate kept (1)"


def no_archive(path: Path, random: Random) -> None:
    """Words where an archive was."""
    del random
    path.write_text("not an archive")


def changed(change: Callable[[Arrays, Random], Arrays]) -> Callable[[Path, Random], None]:
    """Spoil the arrays inside."""

    def spoil(path: Path, random: Random) -> None:
        with np.load(path) as file:
            arrays = {key: file[key] for key in file.files}
        np.savez(path, allow_pickle=False, **change(arrays, random))

    return spoil


def sprinkled(value: float) -> Callable[[Arrays, Random], Arrays]:
    """A bad number in one place that is said to be visible, or hidden."""

    def change(arrays: Arrays, random: Random) -> Arrays:
        positions = arrays["positions"].copy()
        positions[tuple(random.integers(0, size) for size in positions.shape)] = value
        return arrays | {"positions": positions}

    return change


def without_a_key(arrays: Arrays, random: Random) -> Arrays:
    """One array is missing."""
    gone = random.choice(["kind", "positions", "visible", "names", "fps", "up_axis"])
    return {key: value for key, value in arrays.items() if key != gone}


def truncated(path: Path, random: Random) -> None:
    """The end is missing."""
    path.write_bytes(path.read_bytes()[: int(random.integers(0, path.stat().st_size))])


def flipped(path: Path, random: Random) -> None:
    """Some bytes are others."""
    data = bytearray(path.read_bytes())
    for place in random.integers(0, len(data), 20):
        data[place] = int(random.integers(0, 256))
    path.write_bytes(bytes(data))


def hostile(path: Path, random: Random) -> None:
    """Pickled objects, foreign members, other files under the name."""
    del random
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("kind.npy", pickle.dumps({"kind": "joints3d"}))
        archive.writestr("../../escape.npy", b"\x93NUMPY")


SPOILS: dict[str, Callable[[Path, Random], None]] = {
    "missing": lambda path, random: None,
    "outliers": lambda path, random: None,
    "nan": changed(sprinkled(float("nan"))),
    "infinity": changed(sprinkled(float("inf"))),
    "huge": changed(sprinkled(1e30)),
    "one frame": changed(lambda a, r: {k: v[:1] if k in CUT else v for k, v in a.items()}),
    "still": changed(
        lambda a, r: {k: np.repeat(v[:1], 30, 0) if k in CUT else v for k, v in a.items()}
    ),
    "millimetres": changed(lambda a, r: a | {"positions": 1000 * a["positions"]}),
    "y up": changed(lambda a, r: a | {"positions": a["positions"][..., [1, 2, 0]]}),
    "nothing visible": changed(lambda a, r: a | {"visible": a["visible"] & False}),
    "wrong shape": changed(lambda a, r: a | {"positions": a["positions"][:, :, :2]}),
    "a key missing": changed(without_a_key),
    "zero rate": changed(lambda a, r: a | {"fps": np.array(0.0)}),
    "truncated": truncated,
    "flipped bytes": flipped,
    "hostile": hostile,
    "text": no_archive,
}
"""Ways to spoil a file, by name."""
CUT = ("positions", "visible", "truth_visible")


def report(verdicts: Counter[tuple[str, str]], faults: list[str]) -> None:
    """One row per way to spoil."""
    table = Table("spoilt by", "what became of it", "files", title="fuzzed observations")
    for (name, verdict), count in sorted(verdicts.items()):
        table.add_row(name, verdict, str(count))
    console = Console()
    console.print(table)
    console.print(f"{sum(verdicts.values())} files, {len(faults)} faults")
    for fault in faults[:20]:
        console.print(fault, markup=False)


if __name__ == "__main__":
    main()
