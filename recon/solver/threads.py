"""How many threads small problems are solved with: one."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on one thread, and on as many as before afterwards.

    Batches of small matrices gain nothing from several: threads that wait for each other spin, and
    where other processes want the processors too, that costs many times the work.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
