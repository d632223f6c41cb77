"""Block-diagonal systems with ties, against dense solutions."""

import torch

from recon.ingest.tied_frames import Ties, solve_tied


def system(blocks: int, n: int) -> tuple[torch.Tensor, Ties, torch.Tensor, torch.Tensor]:
    """Factors, ties and right side, and the same system as one dense matrix."""
    generator = torch.Generator().manual_seed(0)
    roots = torch.randn(blocks, n, n, generator=generator, dtype=torch.float64)
    stiffness = torch.rand(n, generator=generator, dtype=torch.float64)
    own = roots @ roots.mT + torch.diag_embed(2.1 * stiffness.expand(blocks, n))
    linked = torch.arange(blocks - 1) != 2
    dense = torch.block_diag(*own)
    for i in linked.nonzero()[:, 0].tolist():
        here, after = slice(n * i, n * (i + 1)), slice(n * (i + 1), n * (i + 2))
        dense[here, after] = dense[after, here] = -stiffness.diag()
    right = torch.randn(blocks, n, generator=generator, dtype=torch.float64)
    return torch.linalg.cholesky(own), Ties(stiffness, linked), right, dense


def test_the_solution_is_that_of_the_dense_system() -> None:
    factors, ties, right, dense = system(7, 4)
    found = solve_tied(factors, ties, right, tolerance=1e-10, iterations=50)
    expected = torch.linalg.solve(dense, right.flatten()).unflatten(0, right.shape)
    torch.testing.assert_close(found, expected, atol=1e-8, rtol=0)


def test_few_iterations_come_near() -> None:
    factors, ties, right, dense = system(7, 4)
    exact = torch.linalg.solve(dense, right.flatten()).unflatten(0, right.shape)
    errors = [
        float((solve_tied(factors, ties, right, tolerance=0.0, iterations=k) - exact).norm())
        for k in (0, 2, 4)
    ]
    assert errors[0] > 3 * errors[1] > 9 * errors[2]


def test_blocks_without_ties_are_solved_alone() -> None:
    factors, ties, right, _ = system(3, 4)
    apart = Ties(ties.stiffness, torch.zeros(2, dtype=torch.bool))
    found = solve_tied(factors, apart, right, tolerance=1e-10, iterations=5)
    torch.testing.assert_close((factors @ factors.mT @ found[..., None])[..., 0], right)
