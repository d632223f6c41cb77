"""Builds wheel and sdist, and tries both in empty environments of every Python that is at hand.

    python -m scripts.distributions --out dist
    python -m scripts.distributions --out dist --python python3.12 --any-torch

In each environment the wheel is installed with all dependencies, at the versions of
constraints.txt, and `recon demo`, `recon simulate`, `recon fit` and `recon bench` run; then the
sdist takes its place and the fit runs again. A Python for which pip finds no torch without CUDA's
libraries, which are several gigabytes, gets recon without torch: its files are compiled and
`recon --help` and `recon bench --help` run, unless --any-torch asks for the whole.
"""

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path
from typing import Any

from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
PYTHONS = ("3.11", "3.12", "3.13")
LARGEST = 40e6
"""Largest size of the wheel, bytes."""
LIGHT = ("tyro", "rich")
"""Packages that the command line needs before torch is loaded."""


def main() -> None:
    """Build wheel and sdist, compare them, and try both with every Python."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    parser.add_argument(
        "--python", nargs="+", default=None, help="programs; default: 3.11 to 3.13"
    )
    parser.add_argument("--any-torch", action="store_true", help="install CUDA's libraries, too")
    arguments = parser.parse_args()
    wheel, sdist = build(ROOT, arguments.out.resolve())
    build(ROOT / "film-models", arguments.out.resolve())
    for path in (wheel, sdist):
        print(f"{path.name}: {path.stat().st_size / 1e6:.1f} MB", flush=True)
    if wheel.stat().st_size > LARGEST:
        sys.exit(f"the wheel is larger than {LARGEST / 1e6:.0f} MB")
    programs = arguments.python
    if programs is None:
        at_hand = {version: found(version) for version in PYTHONS}
        programs = [program for program in at_hand.values() if program is not None]
        for version in (version for version, program in at_hand.items() if program is None):
            print(f"Python {version}: not at hand", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        compare(wheel, sdist, Path(folder) / "again")
        for number, program in enumerate(programs):
            place = Path(folder) / str(number)
            place.mkdir()
            said = tried(program, wheel, sdist, place, any_torch=arguments.any_torch)
            print(f"{program}: {said}", flush=True)
            shutil.rmtree(place)


def build(source: Path, out: Path) -> tuple[Path, Path]:
    """Build the wheel and the sdist of a source tree."""
    wheel = WheelBuilder(str(source)).build(directory=str(out), versions=["standard"])
    sdist = SdistBuilder(str(source)).build(directory=str(out), versions=["standard"])
    return Path(next(iter(wheel))), Path(next(iter(sdist)))


def compare(wheel: Path, sdist: Path, folder: Path) -> None:
    """End the program where the sdist does not build the same files as are in the wheel."""
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    (source,) = folder.iterdir()
    again = WheelBuilder(str(source)).build(directory=str(folder / "dist"), versions=["standard"])
    one, other = contents(wheel), contents(Path(next(iter(again))))
    if one != other:
        different = sorted(name for name in {*one, *other} if one.get(name) != other.get(name))
        sys.exit(f"the wheel of the sdist differs in {', '.join(different)}")


def contents(wheel: Path) -> dict[str, str]:
    """Compute SHA-256 of every file of a wheel, keyed by name."""
    with zipfile.ZipFile(wheel) as archive:
        return {
            name: hashlib.sha256(archive.read(name)).hexdigest() for name in archive.namelist()
        }


def found(version: str) -> str | None:
    """Find the program of a Python version, on the path or in pyenv; None where none runs."""
    if sys.version.startswith(f"{version}."):
        return sys.executable
    kept = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    places = sorted(str(place) for place in kept.glob(f"{version}.*/bin/python"))
    for program in (shutil.which(f"python{version}"), *places):
        if program is None:
            continue
        asked = subprocess.run([program, "--version"], capture_output=True, text=True, check=False)
        if asked.stdout.startswith(f"Python {version}."):
            return program
    return None


def tried(program: str, wheel: Path, sdist: Path, place: Path, *, any_torch: bool) -> str:
    """Install and run both in an empty environment of one Python; return a sentence on it."""
    ran(program, "-m", "venv", "environment", cwd=place)
    programs = place / "environment" / ("Scripts" if os.name == "nt" else "bin")
    pip, recon = (str(programs / name) for name in ("pip", "recon"))
    constraint = ("--constraint", str(ROOT / "constraints.txt"))
    if not any_torch and not torch_is_small(pip, constraint, place):
        ran(pip, "install", "--quiet", "--no-deps", str(wheel), cwd=place)
        ran(pip, "install", "--quiet", *constraint, *LIGHT, cwd=place)
        (package,) = (place / "environment").glob("[lL]ib/**/site-packages/recon")
        for name in ("recon", "priors", "observations"):
            ran(str(programs / "python"), "-m", "compileall", "-q", str(package.parent / name),
                cwd=place)  # fmt: skip
        ran(recon, "--help", cwd=place)
        ran(recon, "bench", "--help", cwd=place)
        return "no torch without CUDA's libraries: compiles, says its help; no fit ran"
    ran(pip, "install", "--quiet", "--no-compile", *constraint, str(wheel), cwd=place)
    ran(pip, "check", cwd=place)
    version = ran(recon, "--version", cwd=place).strip()
    ran(recon, "demo", "--out", "demo", "--quiet", cwd=place)
    truth = str(place / "demo" / "noisy.npz")
    seen = ("simulate", truth, "seen.npz", "--kind", "joints3d", "--noise", "0.02")
    ran(recon, *seen, "--frames", "0:60", cwd=place)
    fit = ("fit", "seen.npz", "--prior", "pose", "--quiet", "--out")
    ran(recon, *fit, "of_wheel.npz", cwd=place)
    ran(recon, "bench", "noisy-joints", "--only", "1", "--method", "pose", "--json", "b.json",
        cwd=place)  # fmt: skip
    ran(pip, "install", "--quiet", "--force-reinstall", "--no-deps", str(sdist), cwd=place)
    ran(recon, *fit, "of_sdist.npz", cwd=place)
    for name in ("of_wheel.npz", "of_sdist.npz", "b.json", "demo/demo.html"):
        if not (place / name).is_file():
            sys.exit(f"{program}: {name} was not written")
    return f"wheel and sdist install and fit ({version.splitlines()[0]})"


def torch_is_small(pip: str, constraint: tuple[str, ...], place: Path) -> bool:
    """Whether pip would install torch without the libraries of CUDA.

    Where the index does not serve metadata by itself, pip downloads torch to find out, but none
    of its dependencies.
    """
    asked = ("install", "--quiet", "--dry-run", "--no-deps", "--report", "report.json")
    run = subprocess.run(
        [pip, *asked, *constraint, "torch"], cwd=place, capture_output=True, check=False
    )
    if run.returncode:
        return False
    return asks_for_no_cuda(json.loads((place / "report.json").read_text(encoding="utf-8")))


def asks_for_no_cuda(report: dict[str, Any]) -> bool:
    """Whether no package of pip's report depends on CUDA's libraries in that environment."""
    asked = [
        Requirement(text)
        for one in report["install"]
        for text in one["metadata"].get("requires_dist", [])
    ]
    environment = {**report["environment"], "extra": ""}
    return not any(
        one.name.lower().startswith(("nvidia", "cuda", "triton"))
        and (one.marker is None or one.marker.evaluate(environment))
        for one in asked
    )


def ran(*command: str, cwd: Path) -> str:
    """Run a program without this checkout on its path; return its output.

    Raises:
        SystemExit: with its output, if it fails.
    """
    others = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    run = subprocess.run(command, cwd=cwd, env=others, capture_output=True, text=True, check=False)
    if run.returncode:
        sys.exit(f"{' '.join(command)} ended with {run.returncode}:\n{run.stdout}{run.stderr}")
    return run.stdout


if __name__ == "__main__":
    main()
