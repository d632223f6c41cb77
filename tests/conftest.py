"""What every test shares: shape checking, double precision, a toy body, real data if present."""

import os
from pathlib import Path

import pytest

from tests import shapes

shapes.install("recon", "priors", "observations", "training")

import numpy as np  # noqa: E402
import torch  # noqa: E402

from recon.body.model import BodyModel  # noqa: E402
from tests import perturbed  # noqa: E402

GOLDEN = Path(__file__).parent / "golden"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--ulps", type=int, default=0, help="units in the last place that inputs are moved by"
    )


def pytest_configure(config: pytest.Config) -> None:
    if (ulps := config.getoption("--ulps")) > 0:
        perturbed.install(ulps)


@pytest.fixture(autouse=True)
def _reproducible() -> None:  # pyright: ignore[reportUnusedFunction]
    torch.manual_seed(0)
    torch.set_num_threads(1)
    shapes.counts.clear()


@pytest.fixture(scope="session")
def data() -> Path:
    """Real recordings; tests that need them are skipped where they are absent."""
    folder = os.environ.get("RECON_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip("real recordings are not here: set RECON_DATA to their folder")
    return Path(folder)


@pytest.fixture(scope="session")
def body() -> BodyModel:
    """The bundled body in double precision."""
    return BodyModel.load().to(dtype=torch.float64)


@pytest.fixture(scope="session")
def toy_body() -> BodyModel:
    """A made-up body of 52 vertices, from the golden files, in double precision."""
    with np.load(GOLDEN / "toy_body.npz", allow_pickle=False) as file:
        arrays = {key: torch.from_numpy(file[key].astype(np.float64)) for key in file.files}
    regressor, template = arrays["J_regressor"], arrays["v_template"]
    directions = arrays["shapedirs"]
    return BodyModel(
        name="toy",
        checksum="toy",
        template=template,
        shape_directions=directions,
        pose_directions=None,
        joint_template=regressor @ template,
        joint_directions=torch.einsum("jv,vdk->jdk", regressor, directions),
        weights=arrays["weights"],
        faces=torch.zeros(1, 3, dtype=torch.long),
        male=torch.zeros(16, dtype=torch.float64),
        female=torch.zeros(16, dtype=torch.float64),
    )
