"""Many clips from Python: in parallel, resumable, with a record of what became of each.

    python examples/06_batch.py

The command `recon batch` does the same. Run it again and nothing is fitted twice: a clip is done
as long as the contents of its files and the settings stay what they were.
"""

import json
from importlib import resources
from pathlib import Path

import recon
from recon.batch.batch import fit_all
from recon.batch.worklog import read_manifest
from recon.core.skeleton import JOINTS
from recon.fitting.settings import FitSettings
from recon.formats.observations import PositionsFile, save_observation
from recon.simulation.points import Corruption, joints3d


def recorded(folder: Path, count: int) -> Path:
    """Stands for your recordings: stretches of a walk, and a manifest that lists them."""
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        walk = recon.load_motion(path).motion
    folder.mkdir(exist_ok=True)
    lines = []
    for k in range(count):
        seen = joints3d(
            walk.window(20 * k, 20 * k + 20), recon.BodyModel.load(), Corruption(0.03), k
        )
        file = PositionsFile(
            "joints3d", seen.positions.double().numpy(), seen.visible.numpy(), JOINTS, seen.fps
        )
        save_observation(folder / f"clip{k}.npz", file)
        lines.append(json.dumps({"id": f"clip{k}", "observations": [f"clip{k}.npz"]}))
    (folder / "clips.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / "clips.jsonl"


def main() -> None:
    manifest, out = recorded(Path("recordings"), 3), Path("results")
    out.mkdir(exist_ok=True)
    settings = FitSettings(prior="pose")
    for _ in range(2):  # the second run finds everything done
        clips = read_manifest(manifest)
        for record in fit_all(clips, out, settings, processes=2, log=out / "log.jsonl"):
            print(record["id"], record["status"])


if __name__ == "__main__":
    main()
