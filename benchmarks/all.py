"""Every result file that the tables are made of, one after the other.

    make bench          # RECON_DATA names the folder of real recordings
    python -m benchmarks.all --only humor real --out out

Converts the corpus first (resumable; about half an hour on two cores), then prints each table and
writes one JSON file per table into --out. What is copied from there into benchmarks/results is
what `make tables` writes into the documents.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

_NC = "weights-nc/humor.safetensors"
_RUNS = "ABLATIONS"
_VERSION_0_1_0 = "0ce0517"
_LIKE = "benchmarks/results/complete_published.json"
_CYCLES = ("CORPUS", "--weights", "nc", "--licence", "nc")
_POINTS = ("noisy joints", "occluded points")
_COLUMNS = ("--columns", "p=0", "p=50+lm", "f=5+lm", "p=50")

_HALVES = ("half a body, one camera, posed", "half a body, three views")
_ROLLOUT = ("rollout_fits", "CORPUS", "--part", "validation", "--only", "2", "--protocols")
COMMANDS: dict[str, tuple[str, ...]] = {
    "corpus": ("corpus", "CORPUS"),
    "free_recordings": ("free_recordings", "DATA", "CORPUS"),
    "likeness": ("likeness", "CORPUS"),
    "markers": ("markers", "OBSERVATIONS"),
    "stage12": ("stage12", "CORPUS"),
    "humor": ("humor", "CORPUS", "--frames", "60", "--shooting", "8", "--protocols", _POINTS[0]),
    "humor_hidden": ("humor", "CORPUS", "--frames", "60", "--shooting", "0", "--protocols",
                     _POINTS[1]),
    "failures": ("failures", "CORPUS"),
    "humor_90": ("humor", "CORPUS", "--frames", "90", "--shooting", "0", "--protocols", *_POINTS),
    "humor_recipes": ("humor", "CORPUS", "--frames", "60", "--protocols", "in-betweening",
                      "upper body"),
    "ablations": ("humor", "CORPUS", "--frames", "60", "--only", "24", "--shooting", "0",
                  "--ablations", _RUNS),
    "physics_fit": ("physics_fit", "CORPUS", "--only", "24"),
    "generation_open": ("generation", "CORPUS"),
    "generation_nc": ("generation", "CORPUS", "--weights", "nc"),
    "real": ("real", "OBSERVATIONS"),
    "real_nc": ("real", "OBSERVATIONS", "--weights", "nc"),
    "cameras": ("cameras", "CORPUS", "--only", "24", "--nc", _NC, "--cases", "one camera",
                "one camera, posed", "moving camera", "three views"),
    "cameras_ablations": ("cameras", "CORPUS", "--only", "24", "--ablations", _RUNS, "--cases",
                          "one camera"),
    "cameras_half": ("cameras", "CORPUS", "--only", "8", "--cases", *_HALVES),
    "labels": ("labels", "CORPUS", "PEOPLE", "--only", "15"),
    "clouds": ("clouds", "CORPUS", "--part", "test"),
    "clouds_walks": ("clouds", "CORPUS", "--cases", "walks"),
    "clouds_mixed": ("clouds", "CORPUS", "--part", "test", "--only", "12", "--cases",
                     "depth, sensor unknown", "2D", "2D + depth", "joints", "joints + depth"),
    "pose2sim": ("pose2sim", "OBSERVATIONS"),
    "doors": ("doors", "OBSERVATIONS"),
    "phone": ("phone", "CORPUS", "--part", "validation", "--only", "5", "--cases", "focal"),
    "phone_track": ("phone", "CORPUS", "--part", "validation", "--only", "2", "--cases",
                    "track"),
    "crossings": ("crossings", "CORPUS"),
    "rigs": ("rigs", "CORPUS", "--part", "validation", "--only", "12"),
    "rigs_fit": ("rigs", "CORPUS", "--part", "validation", "--only", "6", "--fit"),
    "undeclared": ("undeclared", "CORPUS"),
    "shared_camera": ("shared_camera", "CORPUS"),
    "slip_sizes": ("slips.sizes", "CORPUS"),
    "slips": ("slips", "CORPUS", "--prior", "pose", "--good", "300", "--observations",
              "OBSERVATIONS"),
    "live": ("live", "CORPUS"),
    "uncertainty": ("uncertainty", "CORPUS"),
    "refine": ("refine", "CORPUS", "--clips", "12"),
    "batch": ("batch", "CORPUS", "BASELINE"),
    "start": ("start", "BASELINE"),
    "pictures": ("pictures", "BASELINE"),
    "convert": ("convert", "BASELINE", "OBSERVATIONS"),
    "nearest": ("nearest",),
    "cycles": ("cycles", "CORPUS"),
    "complete_open": ("complete", "CORPUS", "--weights", "open", "--each", "3"),
    "complete_nc": ("complete", "CORPUS", "--weights", "nc", "--each", "3"),
    "complete_published": ("complete", "CORPUS", "--method", "published", "--each", "3",
                           *_COLUMNS),
    "complete_frames": ("complete", "CORPUS", "--method", "frames", "--like", _LIKE, *_COLUMNS),
    "complete_smooth": ("complete", "CORPUS", "--method", "smooth", "--like", _LIKE, *_COLUMNS),
    "complete_pose": ("complete", "CORPUS", "--method", "pose", "--like", _LIKE, *_COLUMNS),
    "complete_collocation": ("complete", "CORPUS", "--method", "humor", "--weights", "open",
                             "--like", _LIKE, *_COLUMNS),
    "anchor_reconstruction_nc": ("anchor_reconstruction", *_CYCLES),
    "anchor_structure": ("anchor_structure", *_CYCLES),
    "anchor_interpolation": ("anchor_interpolation", *_CYCLES),
    "anchor_morphology": ("anchor_morphology", *_CYCLES),
    "anchor_study": ("anchor_study", "CORPUS", "--licence", "nc", "--out", "STUDY"),
    "anchor_real": ("anchor_real", "OBSERVATIONS"),
    "anchor_speed": ("anchor_speed", "CORPUS", "--weights", "nc"),
    "retarget_shapes_open": ("retarget_shapes", "CORPUS", "--weights", "open", "--licence",
                             "open"),
    "retarget_shapes_nc": ("retarget_shapes", "CORPUS", "--weights", "nc", "--licence", "nc"),
    "retarget": ("retarget", "CORPUS", "--licence", "nc", "--weights", "open", "nc"),
    "humos_prior": ("humos_prior", "CORPUS", "--only", "24"),
    "bodies": ("bodies", "CORPUS", "BODIES"),
    "humos_ablations": ("humos_ablations", "CORPUS", "--out", "HUMOS_ABLATIONS"),
    "long": ("long", "CORPUS", "--prior", "humor", "--seconds", "10", "60"),
    "long_pose": ("long", "CORPUS", "--prior", "pose"),
    "rollout": ("rollout",),
    "rollout_fits": ("rollout_fits", "CORPUS", "--only", "6", "--protocols", "noisy joints"),
    "rollout_fits_hidden": ("rollout_fits", "CORPUS", "--only", "2", "--protocols",
                            "hidden points"),
    "rollout_gap": (*_ROLLOUT, "in-betweening"),
    "rollout_half": (*_ROLLOUT, "upper body"),
    "rollout_camera": (*_ROLLOUT, "one camera", "one camera, posed"),
    "rollout_views": (*_ROLLOUT, "three views"),
    "rollout_depth": (*_ROLLOUT, "keypoints and depth", "joints and depth"),
    "strangers": ("strangers", "CORPUS", "FOLDS"),
    "strangers_all": ("strangers", "CORPUS", "FOLDS"),
    "strangers_varied": ("strangers", "CORPUS", "FOLDS", "--only", "60", "02"),
    "variety": ("strangers.variety", "CORPUS", "FOLDS", "--continued", "400", "--only", "60"),
    "drift": ("drift", "CORPUS"),
    "solver": ("solver",),
    "speed": ("speed",),
    "fuzz": ("fuzz",),
    "fuzz_readers": ("fuzz_readers", "--recordings", "RECORDINGS"),
}  # fmt: skip
"""Result files, each with the module below benchmarks and its arguments. CORPUS, OBSERVATIONS
and DATA are folders of data, other names in capitals are folders of runs below --out."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--only", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    given = parser.parse_args()
    out = given.out.resolve()
    data = Path(os.environ.get("RECON_DATA", ""))
    if not (data / "mocap").is_dir():
        sys.exit("set RECON_DATA to the folder of real recordings (with mocap/, observations/)")
    corpus = out / "corpus"
    run("recon", "convert", "--all", str(data / "mocap"), str(corpus))
    run("benchmarks.free_recordings", str(data), str(corpus))
    if {"ablations", "cameras_ablations"} & set(given.only):
        run("benchmarks.ablations", str(corpus), "--out", str(out / "ablations"))
    beside_0_1_0 = {"batch", "convert", "pictures", "start"} & set(given.only)
    if beside_0_1_0 and not (out / "baseline").is_dir():
        commit = ("git", "worktree", "add", "--detach", str(out / "baseline"), _VERSION_0_1_0)
        subprocess.run(commit, check=True)
    people = out / "people.npz"
    if "labels" in given.only and not people.is_file():
        run("benchmarks.people", str(people))
    places = {
        "CORPUS": str(corpus),
        "PEOPLE": str(people),
        "OBSERVATIONS": str(data / "observations"),
        "DATA": str(data),
        "RECORDINGS": str(data),
    }
    for name in given.only:
        module, *arguments = COMMANDS[name]
        said = [placed(argument, places, out) for argument in arguments]
        run(f"benchmarks.{module}", *said, "--json", str(out / f"{name}.json"))


def placed(argument: str, places: dict[str, str], out: Path) -> str:
    """An argument with its folder in place of a name in capitals."""
    if argument in places:
        return places[argument]
    return str(out / argument.lower()) if argument.isupper() else argument


def run(module: str, *arguments: str) -> None:
    """One table, in a process and with threads of its own."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, "-m", module, *arguments], env=environment, check=True)


if __name__ == "__main__":
    main()
