"""Every table of the README, one after the other.

    make bench          # RECON_DATA names the folder of real recordings

Converts the corpus first (resumable; about half an hour on two cores), then prints each table and
writes one JSON file per table into --out.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out"))
    out = parser.parse_args().out.resolve()
    data = Path(os.environ.get("RECON_DATA", ""))
    if not (data / "mocap").is_dir():
        sys.exit("set RECON_DATA to the folder of real recordings (with mocap/, observations/)")
    corpus = out / "corpus"
    run("recon", "convert", "--all", str(data / "mocap"), str(corpus))
    run("benchmarks.corpus", str(corpus), "--json", str(out / "corpus.json"))
    run("benchmarks.markers", str(data / "observations"), "--json", str(out / "markers.json"))
    run("benchmarks.stage12", str(corpus), "--json", str(out / "stage12.json"))
    nc = str(Path(__file__).parents[1] / "weights-nc" / "humor.safetensors")
    compared = ("--nc", nc, "--shooting", "8")
    run("benchmarks.humor", str(corpus), *compared, "--json", str(out / "humor.json"))
    run("benchmarks.ablations", str(corpus), "--out", str(out / "ablations"))
    parts = ("--frames", "60", "--only", "24", "--shooting", "1")
    parts += ("--ablations", str(out / "ablations"))
    run("benchmarks.humor", str(corpus), *parts, "--json", str(out / "ablations.json"))
    run("benchmarks.physics_fit", str(corpus), "--only", "24", "--json",
        str(out / "physics_fit.json"))  # fmt: skip
    run("benchmarks.generation", str(corpus), "--json", str(out / "generation.json"))
    run("benchmarks.real", str(data / "observations"), "--json", str(out / "real.json"))
    run("benchmarks.cameras", str(corpus), "--only", "24", "--nc", nc, "--ablations",
        str(out / "ablations"), "--cases", "one camera", "one camera, posed", "moving camera",
        "three views", "--json", str(out / "cameras.json"))  # fmt: skip
    sensors = ("depth", "2D of the sensor", "2D + depth")
    run("benchmarks.cameras", str(corpus), "--only", "8", "--cases", *sensors,
        "--json", str(out / "depth.json"))  # fmt: skip
    run("benchmarks.pose2sim", str(data / "observations"), "--json", str(out / "pose2sim.json"))
    run("benchmarks.nearest", "--json", str(out / "nearest.json"))
    run("benchmarks.cycles", str(corpus), "--json", str(out / "cycles.json"))
    for weights in ("open", "nc"):
        run("benchmarks.complete", str(corpus), "--weights", weights,
            "--json", str(out / f"complete_{weights}.json"))  # fmt: skip
    for method in ("published", "frames", "humor"):
        run("benchmarks.complete", str(corpus), "--method", method, "--columns", "p=0",
            "p=50+lm", "p=1000+lm", "--json", str(out / f"complete_{method}.json"))  # fmt: skip
    cycles = ("--weights", "nc", "--licence", "nc")
    for table in ("reconstruction", "structure", "interpolation", "morphology"):
        run(f"benchmarks.anchor_{table}", str(corpus), *cycles,
            "--json", str(out / f"anchor_{table}.json"))  # fmt: skip
    run("benchmarks.anchor_study", str(corpus), "--licence", "nc", "--out", str(out / "study"),
        "--json", str(out / "anchor_study.json"))  # fmt: skip
    run("benchmarks.anchor_real", str(data / "observations"), "--json",
        str(out / "anchor_real.json"))  # fmt: skip
    run("benchmarks.anchor_speed", str(corpus), "--json", str(out / "anchor_speed.json"))
    for weights in ("open", "nc"):
        run("benchmarks.retarget_shapes", str(corpus), "--weights", weights, "--licence", weights,
            "--json", str(out / f"retarget_shapes_{weights}.json"))  # fmt: skip
    run("benchmarks.retarget", str(corpus), "--licence", "nc", "--weights", "open", "nc",
        "--json", str(out / "retarget.json"))  # fmt: skip
    run("benchmarks.humos_prior", str(corpus), "--only", "24", "--json",
        str(out / "humos_prior.json"))  # fmt: skip
    run("benchmarks.humos_ablations", str(corpus), "--out", str(out / "humos_ablations"),
        "--json", str(out / "humos_ablations.json"))  # fmt: skip
    run("benchmarks.long", str(corpus), "--prior", "humor", "--json", str(out / "long.json"))
    run("benchmarks.rollout", "--json", str(out / "rollout.json"))
    run("benchmarks.solver", "--json", str(out / "solver.json"))
    run("benchmarks.speed", "--json", str(out / "speed.json"))
    run("benchmarks.fuzz", "--json", str(out / "fuzz.json"))


def run(module: str, *arguments: str) -> None:
    """One table, in a process and with threads of its own."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, "-m", module, *arguments], env=environment, check=True)


if __name__ == "__main__":
    main()
