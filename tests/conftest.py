"""Settings every test shares: one thread per process and quiet libraries, set before torch is imported."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")
os.environ.setdefault("MPLBACKEND", "Agg")

import pytest
import torch

torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def _no_global_state() -> None:
    """Give every test the same global torch random state, so that the order of the tests is irrelevant."""
    torch.manual_seed(0)
