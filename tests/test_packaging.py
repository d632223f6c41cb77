"""What the distributions hold, what an installation asks for, and that an installed one works."""

import base64
import csv
import hashlib
import os
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

import recon

ROOT = Path(__file__).parents[1]
PACKAGES = ("recon", "priors", "observations")
DATA = [
    path.relative_to(ROOT).as_posix()
    for folder in ("recon/assets", "priors/weights")
    for path in sorted((ROOT / folder).iterdir())
]
"""Data files and weights that an installation needs."""


@pytest.fixture(scope="module")
def sdist(tmp_path_factory) -> tarfile.TarFile:
    folder = tmp_path_factory.mktemp("sdist")
    (archive,) = SdistBuilder(str(ROOT)).build(directory=str(folder), versions=["standard"])
    return tarfile.open(archive)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    return _wheel(ROOT, tmp_path_factory.mktemp("wheel"))


def _wheel(source: Path, folder: Path) -> Path:
    (path,) = WheelBuilder(str(source)).build(directory=str(folder), versions=["standard"])
    return Path(path)


def _sources() -> set[str]:
    found = (path for package in PACKAGES for path in (ROOT / package).rglob("*"))
    return {
        path.relative_to(ROOT).as_posix()
        for path in found
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_the_source_distribution_holds_no_weights_under_another_licence(sdist):
    """It held weights under CC BY-NC while its metadata says MIT."""
    names = {name.partition("/")[2] for name in sdist.getnames()}
    assert not [name for name in names if "weights-nc" in name]
    assert {"LICENSE", "NOTICE", "pyproject.toml", *_sources()} <= names
    assert (ROOT / "weights-nc" / "humor.safetensors").is_file()


def test_an_installation_asks_for_nothing_that_only_tests_use(sdist):
    (about,) = [name for name in sdist.getnames() if name.endswith("/PKG-INFO")]
    file = sdist.extractfile(about)
    assert file is not None
    text = file.read().decode()
    assert "Requires-Dist: torch" in text
    assert "ezc3d" not in text
    assert "Requires-Dist: roma" not in text
    extras = [line for line in text.splitlines() if line.startswith("Provides-Extra")]
    assert sorted(line.split()[-1] for line in extras) == ["ray", "report", "rerun", "usd"]


def test_the_wheel_holds_the_packages_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        (info,) = {name.partition("/")[0] for name in names if ".dist-info/" in name}
        entry_points = archive.read(f"{info}/entry_points.txt").decode()
    assert {name for name in names if not name.startswith(info)} == _sources()
    assert {f"{package}/py.typed" for package in PACKAGES} <= names
    assert {f"{info}/licenses/LICENSE", f"{info}/licenses/NOTICE"} <= names
    assert "recon = recon.cli:main" in entry_points


def test_data_and_weights_come_as_they_are(wheel):
    with zipfile.ZipFile(wheel) as archive:
        (record,) = [name for name in archive.namelist() if name.endswith("/RECORD")]
        said = {row[0]: row[1] for row in csv.reader(archive.read(record).decode().splitlines())}
    assert len(DATA) > 10
    for name in DATA:
        digest = hashlib.sha256((ROOT / name).read_bytes()).digest()
        assert said[name] == f"sha256={base64.urlsafe_b64encode(digest).decode().rstrip('=')}"


def test_sizes_are_those_of_the_documents(wheel):
    text = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
    assert f"the wheel has {wheel.stat().st_size / 1e6:.0f} MB" in " ".join(text.split())


@pytest.mark.slow
def test_both_distributions_install_and_work_in_an_empty_environment(sdist, wheel, tmp_path):
    """Dependencies are those of this environment; nothing is fetched."""
    sdist.extractall(tmp_path / "source", filter="data")
    (source,) = (tmp_path / "source").iterdir()
    again = _wheel(source, tmp_path / "again")
    with zipfile.ZipFile(wheel) as one, zipfile.ZipFile(again) as other:
        assert set(one.namelist()) == set(other.namelist())
    home = tmp_path / "environment"
    venv.create(home, with_pip=False, symlinks=True)
    programs = home / ("Scripts" if os.name == "nt" else "bin")
    python = programs / "python"
    install = ("-m", "pip", "--python", str(python), "install", "--quiet", "--no-index")
    _ran(sys.executable, *install, "--no-deps", str(again), cwd=tmp_path)
    (place,) = home.glob("[lL]ib/**/site-packages")
    (place / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    where = "import recon, priors, observations as o; print(recon.__file__, priors.__file__, o)"
    assert _ran(str(python), "-c", where, cwd=tmp_path).count(str(home)) == 3
    recon_ = str(programs / "recon")
    assert f"recon {recon.__version__}, torch" in _ran(recon_, "--version", cwd=tmp_path)
    _ran(recon_, "demo", "--out", "demo", "--quiet", cwd=tmp_path)
    assert (tmp_path / "demo" / "demo.html").stat().st_size > 100_000


def _ran(*command: str, cwd: Path) -> str:
    """What a program wrote; its environment names no place of this checkout."""
    others = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    run = subprocess.run(command, cwd=cwd, env=others, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout
