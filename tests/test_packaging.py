"""What the source distribution holds, and what an installation asks for."""

import tarfile
from pathlib import Path

import pytest
from hatchling.builders.sdist import SdistBuilder

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def sdist(tmp_path_factory) -> tarfile.TarFile:
    folder = tmp_path_factory.mktemp("sdist")
    (archive,) = SdistBuilder(str(ROOT)).build(directory=str(folder), versions=["standard"])
    return tarfile.open(archive)


def test_the_source_distribution_holds_no_weights_under_another_licence(sdist):
    """It held weights under CC BY-NC while its metadata says MIT."""
    names = {name.partition("/")[2] for name in sdist.getnames()}
    assert not [name for name in names if "weights-nc" in name]
    assert {"LICENSE", "NOTICE", "priors/weights/humor.safetensors"} <= names
    assert (ROOT / "weights-nc" / "humor.safetensors").is_file()


def test_an_installation_asks_for_nothing_that_only_tests_use(sdist):
    (about,) = [name for name in sdist.getnames() if name.endswith("/PKG-INFO")]
    file = sdist.extractfile(about)
    assert file is not None
    text = file.read().decode()
    assert "Requires-Dist: torch" in text
    assert "ezc3d" not in text
    assert "Provides-Extra" not in text
