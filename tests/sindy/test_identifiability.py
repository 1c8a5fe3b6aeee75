"""What the samples can tell: rank and condition as numpy has them, and which functions are to blame."""

import math

import numpy as np
import pytest
import torch

from dynasindy.findings import Finding
from dynasindy.sindy.fit_report import FitReport
from dynasindy.sindy.library import CONSTANT, Library, of, variable
from dynasindy.sindy.regression import TriangularFactor
from dynasindy.systems.base import Signature

SIGNATURE = Signature(("a", "b"), ("rad", "rad/s"), ("u", "v"), (1.0, 1.0))
LIBRARY = Library(SIGNATURE, [CONSTANT, variable("a"), variable("b"), variable("u"), variable("v")])


def samples(n: int = 500, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    generator = np.random.default_rng(seed)
    return torch.from_numpy(generator.uniform(-1, 1, (n, 2))), torch.from_numpy(generator.uniform(-1, 1, (n, 2)))


def judge(library: Library, x, u, xi=None, noise=0.0) -> Finding:
    xi = torch.ones(len(library), 2, dtype=torch.float64) if xi is None else xi
    theta = library(x, u)
    dx = theta @ xi + noise * torch.from_numpy(np.random.default_rng(1).normal(size=(len(x), 2)))
    return FitReport(library, xi, TriangularFactor((theta, dx)), 0.0, len(x)).identifiability


def test_rank_and_condition_are_numpy_s_of_unit_columns():
    x, u = samples()
    found = judge(LIBRARY, x * torch.tensor([1e-4, 1e5]), u)
    theta = LIBRARY(x, u).numpy()
    assert found.values["condition"] == pytest.approx(np.linalg.cond(theta / np.linalg.norm(theta, axis=0)), rel=1e-6)
    assert (found.values["rank"], found.values["count"]) == (5, 5)
    assert f"{found.values['condition']:.2g}" in str(found)


def test_a_function_alone_is_told_from_nothing_else():
    x, u = samples()
    found = judge(Library(SIGNATURE, [variable("a")]), x, u)
    assert (found.values["rank"], found.values["count"]) == (1, 1) and found.values["condition"] == pytest.approx(1.0)


def test_one_signal_on_both_inputs_is_named():
    x, u = samples()
    found = judge(LIBRARY, x, u[:, :1].expand(-1, 2))
    assert found.values["rank"] == 4 and found.values["condition"] > 1e10
    (one, first), (two, second) = found.values["weakest"].items()
    assert {one, two} == {"u", "v"}
    assert first == pytest.approx(-second) and abs(first) == pytest.approx(math.sqrt(0.5))


def test_every_silent_input_is_named():
    x, u = samples()
    found = judge(LIBRARY, x, 0 * u)
    assert found.values["rank"] == 3 and found.values["weakest"] == {"u": 1.0, "v": 1.0}


def test_small_swings_and_speeds_of_one_sign_are_named():
    x, u = samples()
    swing = Library(SIGNATURE, [CONSTANT, variable("a"), of("sin", "a"), of("cos", "a")])
    small = judge(swing, 1e-4 * x, u)
    assert small.values["condition"] > 1e6 and set(small.values["weakest"]) <= {"1", "a", "sin(a)", "cos(a)"}
    drag = Library(SIGNATURE, [variable("b"), of("abs", "b")])
    one_signed = judge(drag, x.abs(), u)
    assert one_signed.values["rank"] == 1 and set(one_signed.values["weakest"]) == {"b", "|b|"}
    assert judge(drag, x, u).values["rank"] == 2
