"""What the distributions hold, what an installation asks for, and that an installed one works."""

import base64
import csv
import hashlib
import os
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

import recon
from scripts.distributions import LARGEST, PYTHONS, asks_for_no_cuda, contents, found, ran

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


def test_the_source_distribution_holds_every_source(sdist):
    names = {name.partition("/")[2] for name in sdist.getnames()}
    assert {"LICENSE", "NOTICE", "pyproject.toml", *_sources()} <= names


def test_an_installation_asks_for_nothing_that_only_tests_use(sdist):
    (about,) = [name for name in sdist.getnames() if name.endswith("/PKG-INFO")]
    file = sdist.extractfile(about)
    assert file is not None
    text = file.read().decode()
    assert "Requires-Dist: torch" in text
    assert "ezc3d" not in text
    assert "Requires-Dist: roma" not in text
    extras = [line for line in text.splitlines() if line.startswith("Provides-Extra")]
    names = sorted(line.split()[-1] for line in extras)
    assert names == ["film", "live", "open3d", "ray", "report", "rerun", "usd"]


def test_the_wheel_holds_the_packages_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        (info,) = {name.partition("/")[0] for name in names if ".dist-info/" in name}
        entry_points = archive.read(f"{info}/entry_points.txt").decode()
    assert {name for name in names if not name.startswith(info)} == _sources()
    assert not [name for name in names if name.startswith(("training/", "tests/", "benchmarks/"))]
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
    assert wheel.stat().st_size <= LARGEST
    text = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
    assert f"wheel has {wheel.stat().st_size / 1e6:.0f} MB" in " ".join(text.split())


def test_what_is_cited_is_what_is_built_on():
    """The papers of two of three learned priors, and the data, were not among the references."""
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {recon.__version__}\n" in text
    for family in ("Rempe", "Marsot", "Tripathi"):
        assert f"family-names: {family}" in text
    assert "mocap.cs.cmu.edu" in text
    assert "EIA-0196217" in text


CARDS = [*(ROOT / "priors/weights").glob("*.md")]


@pytest.mark.parametrize(
    "card",
    [path for path in CARDS if path.with_suffix(".safetensors").is_file()],
    ids=lambda path: f"{path.parent.name}-{path.stem}",
)
def test_a_model_card_says_what_data_licence_and_limits(card):
    text = card.read_text(encoding="utf-8")
    for row in ("what", "data", "licence"):
        assert f"\n| {row} | " in text, f"{card}: no row {row}"
    assert "imits: " in text, f"{card}: says no limits"


def test_pythons_that_do_not_run_are_not_at_hand(tmp_path, monkeypatch):
    """pyenv puts programs of every version on the path, most of which only say no."""
    own = f"{sys.version_info.major}.{sys.version_info.minor}"
    assert found(own) == sys.executable
    says_no = tmp_path / "python9.9"
    says_no.write_text("#!/bin/sh\necho 'command not found' >&2\nexit 127\n")
    says_no.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path / "pyenv"))
    assert found("9.9") is None
    kept = tmp_path / "pyenv" / "versions" / "9.9.1" / "bin"
    kept.mkdir(parents=True)
    (kept / "python").write_text("#!/bin/sh\necho 'Python 9.9.1'\n")
    (kept / "python").chmod(0o755)
    assert found("9.9") == str(kept / "python")


@pytest.mark.parametrize("version", PYTHONS)
def test_the_wheel_alone_says_its_help_in_an_empty_environment(wheel, tmp_path, version):
    """Other versions of Python were tried by hand only; none of them is asked for torch here."""
    program = found(version)
    if program is None:
        pytest.skip(f"no Python {version} at hand")
    python, recon_ = _environment(program, wheel, tmp_path)
    (package,) = (tmp_path / "environment").glob("[lL]ib/**/site-packages/recon")
    sources = [str(package.with_name(name)) for name in PACKAGES]
    ran(python, "-m", "compileall", "-q", *sources, cwd=tmp_path)
    assert ran(python, "-c", "import recon; print(recon.__file__)", cwd=tmp_path).strip() == str(
        package / "__init__.py"
    )
    said = ran(recon_, "--version", cwd=tmp_path)
    assert said.startswith(f"recon {recon.__version__}, torch")
    assert f"Python {version}." in said
    assert "recon fit" in ran(recon_, "fit", "--help", cwd=tmp_path)


@pytest.mark.parametrize(
    ("asked", "small"),
    [
        (["filelock", "sympy>=1.13"], True),
        (["nvidia-cudnn-cu13==9.20.0.48; platform_system == 'Linux'"], False),
        (["nvidia-cudnn-cu13==9.20.0.48; platform_system == 'Windows'"], True),
        (["optree; extra == 'optree'", "triton==3.6; platform_system == 'Linux'"], False),
    ],
)
def test_torch_with_the_libraries_of_cuda_is_told_by_what_it_asks_for(asked, small):
    """All that torch asks for was downloaded, several gigabytes, to find that it is too much."""
    report = {
        "install": [{"metadata": {"name": "torch", "requires_dist": asked}}],
        "environment": {"platform_system": "Linux"},
    }
    assert asks_for_no_cuda(report) == small


def _environment(program: str, distribution: Path, folder: Path) -> tuple[str, str]:
    """Python and recon of an empty environment with a distribution, which borrows the rest.

    Dependencies are those of this environment; nothing is fetched.
    """
    home = folder / "environment"
    ran(program, "-m", "venv", "--without-pip", "--symlinks", str(home), cwd=folder)
    programs = home / ("Scripts" if os.name == "nt" else "bin")
    python = str(programs / "python")
    install = ("-m", "pip", "--python", python, "install", "--quiet", "--no-index", "--no-deps")
    ran(sys.executable, *install, "--no-compile", str(distribution), cwd=folder)
    (place,) = home.glob("[lL]ib/**/site-packages")
    (place / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    return python, str(programs / "recon")


@pytest.mark.slow
def test_both_distributions_install_and_work_in_an_empty_environment(sdist, wheel, tmp_path):
    """Dependencies are those of this environment; nothing is fetched."""
    sdist.extractall(tmp_path / "source", filter="data")
    (source,) = (tmp_path / "source").iterdir()
    again = _wheel(source, tmp_path / "again")
    assert contents(wheel) == contents(again)
    python, recon_ = _environment(sys.executable, again, tmp_path)
    where = "import recon, priors, observations as o; print(recon.__file__, priors.__file__, o)"
    assert ran(python, "-c", where, cwd=tmp_path).count(str(tmp_path / "environment")) == 3
    assert f"recon {recon.__version__}, torch" in ran(recon_, "--version", cwd=tmp_path)
    ran(recon_, "demo", "--out", "demo", "--quiet", cwd=tmp_path)
    seen = ("simulate", "demo/noisy.npz", "seen.npz", "--kind", "joints3d", "--frames", "0:30")
    ran(recon_, *seen, cwd=tmp_path)
    ran(recon_, "fit", "seen.npz", "--prior", "pose", "--out", "back.npz", cwd=tmp_path)
    assert (tmp_path / "back.npz").is_file()
    ran(recon_, "bench", "gap", "--method", "linear", "--json", "found.json", cwd=tmp_path)
    assert (tmp_path / "demo" / "demo.html").stat().st_size > 100_000
