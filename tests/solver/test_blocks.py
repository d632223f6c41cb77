"""Block-tridiagonal systems with a border agree with dense algebra."""

import pytest
import torch

from recon.solver.blocks import Bordered, inverse


def dense(h: Bordered) -> torch.Tensor:
    blocks, n, m = h.border.shape
    whole = torch.zeros(blocks * n + m, blocks * n + m, dtype=torch.float64)
    for i in range(blocks):
        here = slice(i * n, (i + 1) * n)
        whole[here, here] = h.diagonal[i]
        whole[here, blocks * n :], whole[blocks * n :, here] = h.border[i], h.border[i].mT
        if i + 1 < blocks:
            beside = slice((i + 1) * n, (i + 2) * n)
            whole[here, beside], whole[beside, here] = h.upper[i], h.upper[i].mT
    whole[blocks * n :, blocks * n :] = h.corner
    return whole


@pytest.mark.parametrize(("blocks", "n", "m"), [(1, 3, 2), (2, 4, 1), (7, 5, 3)])
def test_marginal_covariances_are_those_of_the_dense_inverse(blocks, n, m):
    generator = torch.Generator().manual_seed(blocks)

    def draw(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    square = draw(blocks, n, n)
    h = Bordered(
        diagonal=square @ square.mT + 20 * torch.eye(n, dtype=torch.float64),
        upper=draw(blocks - 1, n, n),
        border=draw(blocks, n, m),
        corner=30 * torch.eye(m, dtype=torch.float64),
    )
    expected = torch.linalg.inv(dense(h))
    found = inverse(h)
    assert torch.allclose(found.border, expected[blocks * n :, blocks * n :])
    for i in range(blocks):
        here = slice(i * n, (i + 1) * n)
        own = found.within[i] + found.onto[i] @ found.border @ found.onto[i].mT
        assert torch.allclose(own, expected[here, here])
        assert torch.allclose(-found.onto[i] @ found.border, expected[here, blocks * n :])


def test_a_matrix_that_is_not_positive_definite_is_refused():
    eye = torch.eye(2, dtype=torch.float64)
    h = Bordered(
        -eye[None], eye[None, :0].reshape(0, 2, 2), torch.zeros(1, 2, 1).double(), eye[:1, :1]
    )
    with pytest.raises(RuntimeError):
        inverse(h)
