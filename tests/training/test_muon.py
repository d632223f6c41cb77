"""Muon: orthogonal steps for matrices, Adam's for the rest, and a state that is read back."""

import torch

from training.descent import Muon, orthogonalised


def test_steps_of_matrices_are_nearly_orthogonal():
    for shape in ((20, 50), (50, 20)):
        matrix = torch.randn(shape) * torch.logspace(0, -1.5, shape[1])
        values = torch.linalg.svdvals(orthogonalised(matrix))
        assert values.min() > 0.5
        assert values.max() < 1.3
        assert (orthogonalised(matrix) * matrix).sum() > 0


def test_a_quadratic_is_descended_and_goes_on_after_a_restart():
    target = torch.randn(8, 6)

    def run(steps, state=None):
        matrix, vector = torch.zeros(8, 6).requires_grad_(), torch.zeros(6).requires_grad_()
        optimiser = Muon([matrix], [vector], lr=0.05, weight_decay=0.0)
        if state is not None:
            with torch.no_grad():
                matrix.copy_(state["matrix"])
                vector.copy_(state["vector"])
            optimiser.load_state_dict(state["optimiser"])
        for _ in range(steps):
            optimiser.zero_grad()
            loss = (matrix - target).square().sum() + (vector - 1).square().sum()
            loss.backward()
            optimiser.step()
        kept = {"matrix": matrix.detach(), "vector": vector.detach()}
        return kept | {"optimiser": optimiser.state_dict(), "loss": loss.item()}

    whole = run(60)
    assert whole["loss"] < 0.4 * float(target.square().sum())
    again = run(30, run(30))
    torch.testing.assert_close(again["matrix"], whole["matrix"])
    torch.testing.assert_close(again["vector"], whole["vector"])
