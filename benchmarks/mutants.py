"""Mutation testing: which small faults in a module do its tests notice?

    python -m benchmarks.mutants --out benchmarks/results/mutants.json

Every module of `MODULES` gets a sample of the faults of `benchmarks.mutation`, one at a time, and
its tests are run on it until one fails. Each run is a fork of this process, into which the large
libraries are imported before; a module's source is exchanged while it is imported, nothing on disk
is touched.
"""

import argparse
import importlib.machinery
import json
import os
import random
import signal
import sys
import time
from pathlib import Path

from benchmarks.mutation import Mutant, mutant, places

MODULES = {
    "recon/core/robust.py": ("tests/core/test_robust.py",),
    "recon/core/scene.py": ("tests/core/test_scene.py",),
    "recon/core/camera.py": ("tests/core/test_camera.py", "tests/observations/test_checks.py"),
    "recon/formats/mocap/c3d.py": ("tests/formats/test_markers.py",),
    "recon/formats/observations.py": (
        "tests/formats/test_npz.py", "tests/formats/test_keypoints.py",
        "tests/core/test_limits.py",
    ),
    "recon/ingest/markers/fit.py": (
        "tests/ingest/test_ingest.py::test_markers_bring_back_the_motion",
        "tests/ingest/test_markers.py",
    ),
    "recon/solver/line_search.py": (
        "tests/solver/test_line_search.py", "tests/solver/test_lbfgs.py",
    ),
    "recon/solver/lbfgs.py": ("tests/solver/test_lbfgs.py",),
}  # fmt: skip
"""Modules and the tests that answer for them."""
_LIBRARIES = (
    "numpy", "torch", "scipy.optimize", "scipy.spatial", "cv2", "beartype", "jaxtyping",
    "hypothesis", "pytest", "roma",
)  # fmt: skip
_PATIENCE = 5.0
"""Factor of the tests' own CPU seconds, after which a fault counts as noticed: it never ends."""
_ROOT = Path(__file__).parents[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--each", type=int, default=15, help="faults of each module")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--again", type=Path, help="a result whose survivors alone are judged")
    parser.add_argument("--only", nargs="*", default=list(MODULES), help="modules")
    options = parser.parse_args()
    for name in _LIBRARIES:
        __import__(name)
    before = {} if options.again is None else _survivors(options.again)
    rows = [_judge(path, options.each, options.seed, before.get(path)) for path in options.only]
    total = sum(row["mutants"] for row in rows)
    killed = sum(row["killed"] for row in rows)
    # only now, as it imports the modules that were tested
    from benchmarks.results import write

    write(
        options.out, options.seed, each=options.each, modules=rows,
        mutants=total, killed=killed, share=round(killed / total, 3),
    )  # fmt: skip
    print(f"{killed} of {total} killed ({killed / total:.0%})")


def _survivors(result: Path) -> dict[str, set[tuple]]:
    """Mutants that an earlier run with the same sample did not notice, by module."""
    return {
        row["module"]: {
            (s["line"], s["operator"], s["before"], s["after"]) for s in row["survivors"]
        }
        for row in json.loads(result.read_text())["modules"]
    }


def _judge(path: str, each: int, seed: int, before: set[tuple] | None) -> dict:
    """How many of a module's sampled faults its tests notice, and those that they do not.

    Of the faults of an earlier run only those that survived it are tried again: tests grow.
    """
    source = (_ROOT / path).read_text()
    every = places(source)
    some = random.Random(f"{seed} {path}").sample(every, min(each, len(every)))
    chosen = [mutant(source, place) for place in sorted(some)]
    code, limit = _run(path, None, MODULES[path], 3600.0)
    if code != 0:
        raise SystemExit(f"{path}: its tests fail without any fault ({', '.join(MODULES[path])})")
    survivors: list[Mutant] = []
    for one in chosen:
        known = (one.line, one.operator, one.before, one.after)
        if before is not None and known not in before:
            continue
        code, seconds = _run(path, one.source, MODULES[path], _PATIENCE * limit + 10)
        print(f"{path}:{one.line} {one.operator}: {one.before[:60]!r} -> {one.after[:60]!r}",
              "survived" if code == 0 else "killed", f"{seconds:.1f} s", flush=True)  # fmt: skip
        if code == 0:
            survivors.append(one)
    return {
        "module": path,
        "possible": len(every),
        "mutants": len(chosen),
        "killed": len(chosen) - len(survivors),
        "survivors": [
            {"line": s.line, "operator": s.operator, "before": s.before, "after": s.after}
            for s in survivors
        ],
    }


def _run(path: str, source: str | None, tests: tuple[str, ...], limit: float) -> tuple[int, float]:
    """Exit code of the tests on a source, zero where all pass, and their CPU seconds."""
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
    # libraries that are plugins of pytest, too, were imported before it could rewrite them
    quiet = ["-W", "ignore::pytest.PytestAssertRewriteWarning", "-p", "no:cacheprovider"]
    return int(pytest.main(["-x", "-q", *quiet, "-m", "not slow", *tests]))


def _exchange(path: Path, source: str) -> None:
    """Have the import system read another source for one file, and no compiled one."""
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
