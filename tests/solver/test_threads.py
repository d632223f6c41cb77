"""One thread inside, as many as before outside."""

import pytest
import torch

from recon.solver.solution import one_thread


def test_threads_are_put_back_whatever_happens() -> None:
    torch.set_num_threads(2)
    with one_thread():
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == 2
    with pytest.raises(KeyError), one_thread():
        raise KeyError
    assert torch.get_num_threads() == 2
