"""Names of files and of points that mean something to what shows them: each is shown as text."""

import csv
import html.parser
import importlib.util
import json
import struct
from importlib import resources
from pathlib import Path

import pytest

from recon import cli
from recon.formats.motions import load_motion, save_motion
from recon.mocap.bvh import read_bvh
from recon.mocap.marker_tables import read_trc

NAMES = (
    '"><img src=x onerror=document.title=1>', "<script>document.title=1<\u2215script>",
    "'onmouseover='document.title=1", "<!--", "<svg onload=document.title=1>",
    "[red]", "[link=javascript:1]x[\u2215link]", "$^{$", "\\frac{\\", "{0} %s %n &lt;b&gt;",
    "\x1b]0;title\x07", "\x1b[2J", "\u202egpj", "\r over", "\n# heading",
    "=HYPERLINK(1)", "`code` | cell |", "\udcff", "\u2028", 'a,b;"c"\t',
)  # fmt: skip
"""Four at a time are one name below, so that few outputs show all of them."""
TAGS = {"img", "a", "iframe", "object", "embed", "base", "form"}


class Page(html.parser.HTMLParser):
    """The scripts of a page, and what of it is none of recon's."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.strange: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        events = [key for key, _ in attrs if key.startswith("on")]
        self.strange += events + [tag] * (tag in TAGS)

    def handle_comment(self, data: str) -> None:
        self.strange += [data] * ("<" in data)


@pytest.fixture(scope="module", params=range(0, len(NAMES), 4))
def named(request, tmp_path_factory) -> Path:
    """Half a second of the bundled clip under four of the names."""
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        motion = load_motion(path).motion.window(30, 45)
    word = "".join(NAMES[request.param : request.param + 4])
    target = tmp_path_factory.mktemp("named") / f"{word}.npz"
    save_motion(target, motion)
    return target


def told(capsys, *words: object) -> None:
    """Run a verb; what it writes are printable lines."""
    assert cli.run([str(word) for word in words]) == cli.OK
    out, err = capsys.readouterr()
    assert all(line.isprintable() for line in (out + err).split("\n"))


def test_in_the_terminal(named, capsys):
    told(capsys, "info", named)
    assert cli.run(["info", f"{named}.missing"]) != cli.OK
    assert all(line.isprintable() for line in capsys.readouterr().err.split("\n"))


def test_of_markers_in_the_terminal(capsys, tmp_path):
    # what ends a line or is no letter of UTF-8 is no part of a label
    labels = [" ".join(name.replace("\udcff", "").split()) for name in NAMES]
    places = "".join(f"\t0\t{0.1 * k:.1f}\t0" for k in range(len(labels)))
    lines = (
        "PathFileType\t4\t(X/Y/Z)\ta.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame"
        "\tOrigNumFrames",
        f"30\t30\t9\t{len(labels)}\tm\t30\t1\t9",
        "Frame#\tTime\t" + "\t\t\t".join(labels),
        "\t\tX1", "", *(f"{k}\t{k / 30:.3f}{places}" for k in range(9)),
    )  # fmt: skip
    (tmp_path / "labels.trc").write_text("\n".join(lines), encoding="utf-8")
    told(capsys, "info", tmp_path / "labels.trc")


def test_in_pages_and_plots(named, capsys):
    page, report = named.with_suffix(".html"), named.with_suffix(".report.html")
    told(capsys, "view", named, "--html", page, "--png", named.with_suffix(".png"))
    told(capsys, "report", named, "--out", report)
    assert Page(page).strange == []
    assert Page(report).strange == []
    with report.with_suffix(".csv").open(newline="", encoding="utf-8") as file:
        assert len({len(row) for row in csv.reader(file)}) == 1


def test_in_files_for_other_programs(named, capsys):
    usd = ("usda",) if importlib.util.find_spec("pxr") else ()
    files = {kind: named.with_suffix(f".{kind}") for kind in ("glb", "bvh", "trc", *usd)}
    told(capsys, "export", named, *(w for k, path in files.items() for w in (f"--{k[:3]}", path)))
    assert read_bvh(files["bvh"]).frames == 15
    assert read_trc(files["trc"]).frames == 15
    length, kind = struct.unpack_from("<I4s", files["glb"].read_bytes(), 12)
    assert kind == b"JSON"
    json.loads(files["glb"].read_bytes()[20 : 20 + length])
