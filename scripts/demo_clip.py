"""Cut the bundled demo clip out of the converted corpus.

    recon convert --all MOCAP CORPUS
    python scripts/demo_clip.py CORPUS

CMU subject 16, a walk, of the test split: nothing in the package has learned from it.
"""

import argparse
import dataclasses
from pathlib import Path

import recon
from recon.formats.motions import load_motion, save_motion

CLIP, SECONDS, FPS = "cmu/16_32.npz", 4.0, 30.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("corpus", type=Path)
    source = parser.parse_args().corpus / CLIP
    file = load_motion(source)
    motion = file.motion.replace(start_time=0.0).resample(FPS).window(0, int(SECONDS * FPS))
    kept = {"joints": None, "contacts": None, "joint_std": None}
    target = Path(recon.__file__).parent / "assets" / "demo.npz"
    save_motion(target, dataclasses.replace(file, motion=motion, **kept))
    print(f"{target}: {motion.frames} frames")


if __name__ == "__main__":
    main()
