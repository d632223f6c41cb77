"""Freely licensed marker recordings as clips of the corpus, beside those of `recon convert --all`.

    recon convert --all DATA/mocap CORPUS
    python -m benchmarks.free_recordings DATA CORPUS --out FOLDER

DATA is the folder of all real recordings. `free_recordings.toml` lists every freely licensed
recording that is not in the main folders of CMU's collection: who moves, under which licence, and
whether it is learned from, or why not. Those with a clip name are converted to
CORPUS/observations/CLIP.npz, with notes beside (CLIP.json) that hold the licence.

The tables tell each recording's use, length and residual, and clips, people and minutes of the
open corpus with the recordings that are learned from, and without.
"""

import json
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.protocol import Cell, Table, number, parser, tell
from recon.benchmark.dataset import SPLITS, Splits, clip_files
from recon.body.model import BodyModel
from recon.body.parts import centre_of_mass, vertex_masses_of_segments
from recon.core.motion import Motion
from recon.core.skeleton import FEET
from recon.formats.motions import load_motion
from recon.formats.replacing import file_checksum, write_text
from recon.ingest.single import convert

LIST = Path(__file__).parent / "free_recordings.toml"
FOLDER = "observations"
"""Folder of the corpus that the marker recordings are written to."""
PARTS = ("train", "validation")
PART_NAMES = {"train": "training", "validation": "validation"}
WORDS = {"train": "trains", "validation": "validates", "test": "only tested", "none": "unused"}
COLUMNS = (("recording", None), ("person", None), ("motion", None), ("licence", None), ("s", 1),
           ("residual mm", 1), ("falls at m/s²", 1), ("used, and why", None))  # fmt: skip
MINUTES = (("part", None), ("clips", 0), ("known people", 0), ("minutes", 2),
           ("on flat ground", 2), ("of which with contacts", 2))  # fmt: skip
ALOFT, SHORTEST_FLIGHT = 0.05, 0.2
"""Metres and seconds; somebody on tiptoe lifts the joints of the toes by less."""
UNKNOWN = "unknown"
"""The subject of clips of which nobody knows who moves in them; counted as nobody."""


@dataclass(frozen=True)
class FreeRecording:
    """A freely licensed recording and what it is used for."""

    path: str
    """Below the folder of all real recordings."""
    person: str
    motion: str
    """What is done."""
    licence: str
    """Name of the licence."""
    use: Literal["train", "validation", "test", "none"]
    why: str
    clip: str | None = None
    """Name of the clip that is made of it here; None where none is."""

    @property
    def clip_name(self) -> str:
        """Name of the clip in the corpus, whoever converts it."""
        return self.clip or Path(self.path).name.split(".")[0]


def load_list(path: Path = LIST) -> tuple[tuple[FreeRecording, ...], dict[str, str]]:
    """All listed recordings, and the words of their licences by name."""
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    return tuple(FreeRecording(**row) for row in table["recording"]), dict(table["licences"])


def main() -> None:
    """Convert, note licences, count, print and write."""
    asked = parser(__doc__, "data", "corpus")
    asked.add_argument("--splits", type=Path, default=SPLITS)
    arguments = asked.parse_args()

    recordings, licences = load_list()
    body = BodyModel.load()
    for recording in recordings:
        if recording.clip is not None:
            convert_one(arguments.data, arguments.corpus, recording, body)
    files = clip_files(arguments.corpus)
    used = [one for one in recordings if one.use in PARTS]
    new = {one.clip_name for one in used}
    if missing := sorted(new - set(files)):
        raise FileNotFoundError(
            f"{arguments.corpus}: expected the clips {', '.join(missing)}, too; "
            f"run recon convert --all on {arguments.data / 'mocap'} first"
        )
    for one in used:
        note_licence(files[one.clip_name], one, licences)
    notes = {name: noted(path) for name, path in files.items()}
    splits = Splits.load(arguments.splits)
    counts = {
        "without": counted({k: v for k, v in notes.items() if k not in new}, splits),
        "with": counted(notes, splits),
    }
    rows: list[list[Cell]] = []
    for one in recordings:
        row = measured(files[one.clip_name], body) if one.use in PARTS else {}
        rows.append([one.path.split("/", 1)[1], one.person, one.motion, one.licence,
                     *(number(row.get(key)) for key in ("seconds", "residual_mm", "falls")),
                     f"{WORDS[one.use]}: {one.why}"])  # fmt: skip
    lines: list[list[Cell]] = [
        [f"{PART_NAMES[part]}, {label} them", *map(number, own[part].values())]
        for part in PARTS
        for label, own in counts.items()
    ]
    sources = {
        "DATA": (arguments.data, [arguments.data / one.path for one in used]),
        "CORPUS": (arguments.corpus, files.values()),
    }
    tables = {"free-recordings": Table(COLUMNS, rows), "free-minutes": Table(MINUTES, lines)}
    tell(arguments.out, None, sources, tables)


def convert_one(data: Path, corpus: Path, recording: FreeRecording, body: BodyModel) -> Path:
    """Write a marker recording as a clip of the corpus, its notes beside it.

    Raises:
        FileNotFoundError, ValueError: as `recon.convert`.
    """
    found = convert(data / recording.path, body)
    path = corpus / FOLDER / f"{recording.clip_name}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    found.save(path, body)
    notes = {
        "collection": FOLDER,
        "clip": recording.clip_name,
        "subject": recording.person,
        "action": recording.motion,
        "kept": True,
        **found.report,
        "flat": True,
        "contacts": not found.on_belt,
        "skeleton": "markers",
        "recording": recording.path,
        "checksum": file_checksum(path),
    }
    _write(path, notes)
    return path


def note_licence(motion: Path, recording: FreeRecording, licences: Mapping[str, str]) -> None:
    """Put the licence of a recording and its words among the notes beside its motion."""
    terms = {"licence": recording.licence, "terms": licences[recording.licence]}
    _write(motion, {**noted(motion), **terms})


def noted(motion: Path) -> dict[str, Any]:
    """What the conversion noted beside a motion; its length alone where it noted nothing."""
    beside = motion.with_suffix(".json")
    if beside.is_file():
        return json.loads(beside.read_text(encoding="utf-8"))
    read = load_motion(motion).motion
    return {"seconds": read.frames / read.fps}


def counted(notes: Mapping[str, Mapping[str, Any]], splits: Splits) -> dict[str, dict[str, float]]:
    """Clips, known people and minutes of each part, of clips that an open package may learn from.

    Feet are judged on one plane alone, and contacts are learned where the feet are the person's
    own, so minutes of both kinds are counted, too.
    """
    parts = splits.parts(list(notes))
    found: dict[str, dict[str, float]] = {}
    for part in PARTS:
        own = [clip for clip, its in parts.items() if its == part and splits.is_open(clip)]
        flat = [clip for clip in own if notes[clip].get("flat", True)]
        stands = [clip for clip in flat if notes[clip].get("contacts", True)]
        found[part] = {
            "clips": len(own),
            "people": len({splits.subject(clip) for clip in own} - {UNKNOWN}),
            "minutes": _minutes(notes, own),
            "minutes on flat ground": _minutes(notes, flat),
            "minutes with contacts": _minutes(notes, stands),
        }
    return found


def _minutes(notes: Mapping[str, Mapping[str, Any]], clips: Iterable[str]) -> float:
    return sum(float(notes[clip]["seconds"]) for clip in clips) / 60


def measured(path: Path, body: BodyModel) -> dict[str, float | None]:
    """Length, residual and slip of a converted recording, and how fast its flights fall."""
    notes, file = noted(path), load_motion(path)
    row = {key: notes.get(key) for key in ("seconds", "residual_mm", "slip_mps")}
    return {**row, "falls": falls(file.motion, body)}


def falls(motion: Motion, body: BodyModel) -> float | None:
    """Acceleration downwards of the centre of mass in the longest flight, m/s²; None without one.

    It is 9.8 where the unit of length is right. In a flight no joint of a foot is within `ALOFT`
    of where it stands, its 5th percentile of heights.
    """
    feet = body.pose(motion).joints[:, list(FEET), 2].numpy()
    high = (feet > np.percentile(feet, 5, axis=0) + ALOFT).all(1)
    edges = np.flatnonzero(np.diff(np.r_[0, high, 0])).reshape(-1, 2)
    first, last = max(edges.tolist(), key=lambda run: run[1] - run[0], default=(0, 0))
    if last - first < SHORTEST_FLIGHT * motion.fps:
        return None
    flight = body.pose(motion.window(first, last))
    centre = centre_of_mass(flight, vertex_masses_of_segments(body))[:, 2].numpy()
    times = (np.arange(last - first) - (last - first - 1) / 2) / motion.fps
    return float(-2 * np.polyfit(times, centre, 2)[0])


def _write(motion: Path, notes: Mapping[str, Any]) -> None:
    """The notes beside a motion."""
    write_text(motion.with_suffix(".json"), json.dumps(notes, indent=1) + "\n")


if __name__ == "__main__":
    main()
