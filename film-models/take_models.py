"""Takes the model files out of the wheel of mediapipe and checks them.

    python film-models/take_models.py

mediapipe itself is not installed, as it asks for versions that recon does not work with.
"""

import hashlib
import re
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

HERE = Path(__file__).parent
FOLDER = HERE / "src" / "recon_film_models"
WHEEL = ("mediapipe==0.10.21", "--python-version", "3.12", "--platform", "manylinux_2_28_x86_64")
PLACES = (
    "mediapipe/modules/pose_detection/pose_detection.tflite",
    "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
    "mediapipe/modules/palm_detection/palm_detection_full.tflite",
    "mediapipe/modules/hand_landmark/hand_landmark_full.tflite",
)


def checksums() -> dict[str, str]:
    """SHA-256 of every model file by name, as the README lists them."""
    text = (HERE / "README.md").read_text(encoding="utf-8")
    return dict(re.findall(r"`([\w.]+\.tflite)`.*`([0-9a-f]{64})`", text))


def main() -> None:
    """Download, check and unpack."""
    with tempfile.TemporaryDirectory() as folder:
        download = (sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary", ":all:")
        subprocess.run([*download, "--dest", folder, *WHEEL], check=True)
        (wheel,) = Path(folder).glob("*.whl")
        with zipfile.ZipFile(wheel) as archive:
            found = {Path(place).name: archive.read(place) for place in PLACES}
    for name, content in found.items():
        if hashlib.sha256(content).hexdigest() != checksums()[name]:
            sys.exit(f"{name}: the wheel has another file than the README says")
        (FOLDER / name).write_bytes(content)


if __name__ == "__main__":
    main()
