"""A C3D file of a motion-capture laboratory, onto the body.

    python examples/05_c3d.py [TRIAL.c3d]

Markers are recognised by the labels of common protocols; unit and up axis come from the file.
Without a file, one is written for the bundled walk (this needs `pip install ezc3d`).
"""

import sys
from importlib import resources
from pathlib import Path

import numpy as np

import recon
from recon.body.landmarks import landmark
from recon.body.marker_labels import match_markers

PAIRS = (
    "FHD", "BHD", "SHO", "UPA", "ELB", "WRA", "WRB", "FIN",
    "ASI", "PSI", "THI", "KNE", "TIB", "ANK", "HEE", "TOE",
)  # fmt: skip
LABELS = ("CLAV", "C7", "STRN", "T10", *(side + name for side in "LR" for name in PAIRS))


def written(path: Path) -> Path:
    """Stands for your laboratory: the bundled walk with the markers of Plug-in Gait."""
    import ezc3d

    body = recon.BodyModel.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as demo:
        truth = recon.load_motion(demo).motion.window(0, 30)
    names, _ = match_markers(LABELS)
    vertices = [landmark(names[label]) for label in LABELS]
    places = 1000 * body.pose(truth).vertices[:, vertices].double().numpy()  # (frames, markers, 3)
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [truth.fps]
    file["parameters"]["POINT"]["LABELS"]["value"] = list(LABELS)
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["data"]["points"] = np.insert(places, 3, 1.0, axis=-1).transpose(2, 1, 0)  # homogeneous
    file.write(str(path))
    return path


def main() -> None:
    trial = Path(sys.argv[1]) if len(sys.argv) > 1 else written(Path("trial.c3d"))
    found = recon.convert(trial)
    for decision in found.about["decisions"]:
        print("decided:", decision)
    for finding in (*found.repairs, *found.warnings):
        print(f"{finding.code}: {finding.message}")
    print(found)
    found.save("trial.npz", overwrite=True)


if __name__ == "__main__":
    main()
