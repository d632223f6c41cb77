"""`scripts.compare_interfaces` reports removed and moved names, and nothing else."""

from scripts.compare_interfaces import differences, moved, offers

TABLE = "| then | now |\n|---|---|\n| `recon.robust` | `recon.core.robust` (`a` is `b`) |\n"


def written(folder, sources):
    for name, text in sources.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return offers(folder)


def test_only_what_the_table_does_not_tell_has_a_line(tmp_path):
    """Hundreds of lines about moved modules hid the names that were gone."""
    old = written(tmp_path / "old", {
        "recon/robust.py": "LIMIT = 1.0\ndef squared(x): ...\ndef huber(x): ...\n",
        "recon/own.py": "class Seen:\n    noise: float\n    def start(self): ...\n",
    })  # fmt: skip
    new = written(tmp_path / "new", {
        "recon/core/robust.py": "LIMIT = 1.0\ndef squared(x): ...\n",
        "recon/base.py": "class Record:\n    def start(self): ...\n",
        "recon/own.py": "class Seen(Record):\n    std: float\n",
    })  # fmt: skip
    found = differences(old, new, moved(TABLE))
    assert found == ["without: recon.own.Seen: noise", "gone: recon.robust.huber"]


def test_a_name_in_another_module_than_the_table_says_has_all_its_places(tmp_path):
    """The first of several things of one name was given as where it had moved to."""
    old = written(tmp_path / "old", {"recon/robust.py": "def tukey(x): ...\n"})
    new = written(tmp_path / "new", {
        "observations/curvature.py": "def tukey(x): ...\n",
        "recon/other.py": "def tukey(x): ...\n",
    })  # fmt: skip
    (line,) = differences(old, new, moved(TABLE))
    assert line == "elsewhere: recon.robust.tukey -> observations.curvature, recon.other"
