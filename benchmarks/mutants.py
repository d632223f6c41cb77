"""Mutation testing: counts the small faults in modules that their tests notice.

    python -m benchmarks.mutants --out benchmarks/results

Every module of `MODULES` gets a sample of the faults of `benchmarks.mutation`, one at a time, and
its tests run with it until one fails. Each run is a fork of this process, in which the large
libraries are already imported; a module's source is replaced while it is imported, and nothing on
disk is changed.
"""

import argparse
import importlib.machinery
import os
import random
import signal
import sys
import time
from pathlib import Path

from benchmarks.mutation import mutant, places

MODULES = {
    "recon/core/residuals.py": (
        "tests/core/test_robust.py", "tests/observations/test_residuals.py",
    ),
    "recon/core/scene.py": (
        "tests/core/test_scene.py", "tests/core/test_planes.py", "tests/method/test_newton.py",
    ),
    "recon/core/camera.py": (
        "tests/core/test_camera.py", "tests/core/test_lens.py", "tests/core/test_ground.py",
        "tests/observations/test_checks.py",
        "tests/formats/test_calibration.py", "tests/observations/test_keypoints2d.py",
    ),
    "recon/mocap/c3d.py": (
        "tests/formats/test_markers.py", "tests/formats/test_clinic_files.py",
        "tests/formats/test_real.py", "tests/formats/test_foreign.py",
    ),
    "recon/formats/observations.py": (
        "tests/formats/test_npz.py", "tests/formats/test_keypoints.py",
        "tests/core/test_limits.py",
    ),
    "recon/ingest/marker_fit.py": (
        "tests/ingest/test_marker_frames.py", "tests/ingest/test_marker_neighbours.py",
        "tests/ingest/test_clinic.py",
        "tests/ingest/test_marker_poses.py", "tests/ingest/test_markers.py",
    ),
    "recon/solver/line_search.py": (
        "tests/solver/test_line_search.py", "tests/solver/test_lbfgs.py",
    ),
    "recon/solver/lbfgs.py": ("tests/solver/test_lbfgs.py",),
}  # fmt: skip
"""Modules that get faults, and the tests that are run for each."""
_LIBRARIES = (
    "numpy", "torch", "scipy.optimize", "scipy.spatial", "cv2", "beartype", "jaxtyping",
    "hypothesis", "pytest", "roma",
)  # fmt: skip
_MAX_TIME_RATIO = 5.0
"""Ratio to the tests' own CPU seconds after which a fault counts as noticed, as in endless
loops."""
_ROOT = Path(__file__).parents[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=None, help="folder of the table")
    parser.add_argument("--each", type=int, default=15, help="faults of each module")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=list(MODULES), help="modules")
    options = parser.parse_args()
    for name in _LIBRARIES:
        __import__(name)
    rows = [_judge(path, options.each, options.seed) for path in options.only]
    total = sum(row["mutants"] for row in rows)
    killed = sum(row["killed"] for row in rows)
    # imported here: it imports modules under test, which each fork must import in changed form
    from benchmarks.protocol import Table, tell

    cells = [[f"`{row['module']}`", row["mutants"], str(row["killed"])] for row in rows]
    cells.append(["all", total, f"{killed} ({100 * killed / total:.0f} %)"])
    columns = (("module", None), ("faults tried", 0), ("noticed", None))
    tell(options.out, options.seed, {}, {"mutants": Table(columns, cells)})
    print(f"{killed} of {total} killed ({killed / total:.0%})")


def _judge(path: str, each: int, seed: int) -> dict:
    """Count the sampled faults of a module that its tests notice; print each result."""
    source = (_ROOT / path).read_text()
    every = places(source)
    some = random.Random(f"{seed} {path}").sample(every, min(each, len(every)))
    chosen = [mutant(source, place) for place in sorted(some)]
    code, limit = _run(path, None, MODULES[path], 3600.0)
    if code != 0:
        raise SystemExit(f"{path}: its tests fail without any fault ({', '.join(MODULES[path])})")
    killed = 0
    for one in chosen:
        code, seconds = _run(path, one.source, MODULES[path], _MAX_TIME_RATIO * limit + 10)
        killed += code != 0
        print(f"{path}:{one.line} {one.operator}: {one.before[:60]!r} -> {one.after[:60]!r}",
              "survived" if code == 0 else "killed", f"{seconds:.1f} s", flush=True)  # fmt: skip
    return {"module": path, "mutants": len(chosen), "killed": killed}


def _run(path: str, source: str | None, tests: tuple[str, ...], limit: float) -> tuple[int, float]:
    """Run tests with a module's source; return exit code (zero if all pass) and CPU seconds."""
    child = os.fork()
    if child == 0:
        os._exit(_tested(path, source, tests, limit))
    _, status, used = os.wait4(child, 0)
    return status, used.ru_utime + used.ru_stime


def _tested(path: str, source: str | None, tests: tuple[str, ...], limit: float) -> int:
    import resource

    import pytest

    began = time.process_time()
    resource.setrlimit(resource.RLIMIT_CPU, (int(began + limit) + 1, int(began + limit) + 5))
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
    os.chdir(_ROOT)
    if source is not None:
        _exchange(_ROOT / path, source)
    # pytest warns that it cannot rewrite plugins that are imported already: this is expected
    quiet = ["-W", "ignore::pytest.PytestAssertRewriteWarning", "-p", "no:cacheprovider"]
    return int(pytest.main(["-x", "-q", *quiet, "-m", "not slow", *tests]))


def _exchange(path: Path, source: str) -> None:
    """Make the import system read another source for one file, and no compiled one."""
    loader = importlib.machinery.SourceFileLoader
    stats, data = loader.path_stats, loader.get_data

    def path_stats(self, name):
        if Path(name) == path:
            raise OSError("its compiled code is of another source")
        return stats(self, name)

    def get_data(self, name):
        return source.encode() if Path(name) == path else data(self, name)

    for method in (path_stats, get_data):
        setattr(loader, method.__name__, method)
    sys.dont_write_bytecode = True


if __name__ == "__main__":
    main()
