"""A report's figures are those of the samples, as is what they cannot tell."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from dynasindy.findings import Finding
from dynasindy.sindy import FitReport, Library, Refinement, Regression, SindyModel
from dynasindy.sindy.covariance import Covariance
from dynasindy.sindy.library import CONSTANT, of, variable
from dynasindy.sindy.regression import TriangularFactor
from dynasindy.systems import Signature
from dynasindy.systems.transitions import Transitions

PLAIN = Library(Signature(("a", "b"), ("rad", "rad/s"), ("u",), (1.0, 1.0)), [CONSTANT, variable("a"), variable("u")])
XI = torch.tensor([[0.0, 1.0], [2.0, 0.0], [0.0, -1.0]], dtype=torch.float64)


def rows(seed: int = 0, noise: float = 0.3) -> tuple[torch.Tensor, torch.Tensor]:
    generator = np.random.default_rng(seed)
    theta = PLAIN(torch.from_numpy(generator.normal(size=(90, 2))), torch.from_numpy(generator.normal(size=(90, 1))))
    return theta, theta @ XI + noise * torch.from_numpy(generator.normal(size=(90, 2)))


def report(data) -> tuple[FitReport, TriangularFactor]:
    factor = TriangularFactor(data)
    return FitReport(PLAIN, XI, factor, 0.25, 90, dt=0.01), factor


def test_unexplained_parts_are_those_of_the_samples():
    theta, dx = rows()
    found, _ = report((theta, dx))
    expected = np.linalg.norm(dx - theta @ XI, axis=0) / np.linalg.norm(dx, axis=0)
    assert list(found.residual) == ["a", "b"]
    assert list(found.residual.values()) == pytest.approx(expected.tolist(), rel=1e-9)
    assert found.terms == {"a": 1, "b": 2} and found.samples == 90 and found.seconds == 0.25


def test_the_text_says_how_well_coefficients_are_known():
    found, _ = report(rows())
    assert found.accuracy == []
    places = torch.tensor([1, 0, 2]), torch.tensor([0, 1, 1])
    told = replace(found, covariance=Covariance(*places, torch.diag(torch.tensor([0.004, 0.03, 0.25])).double()))
    (known,) = told.accuracy
    assert known.code == "fit.standard_errors" and not known.values["of_step"]
    assert (known.values["median"], known.values["worst"]) == (pytest.approx(3), pytest.approx(25))
    assert known.values["least"] == "u in b'" and str(known) in told.to_text().splitlines()


def test_coefficients_of_a_difference_equation_are_those_of_the_change_in_a_step():
    _, factor = report(rows())
    known = Covariance(torch.tensor([2]), torch.tensor([1]), torch.diag(torch.tensor([0.25])).double())
    stepped = replace(FitReport(PLAIN.with_step(0.01), XI, factor, 0.25, 90, dt=0.01), covariance=known)
    (known,) = stepped.accuracy
    assert known.values["worst"] == pytest.approx(25) and known.values["of_step"]
    assert known.values["least"] == "u in the change of b"
    part = f"{100 * stepped.residual['a']:.3g} %"
    assert stepped.to_text().splitlines()[1].startswith(f"  a[k+1] - a[k]: 1 term; {part}")


def test_what_the_others_of_an_equation_leave_over_of_a_function_is_the_sine_of_the_angle_between_them():
    """Columns at an angle of 0.01 rad leave a hundredth over of each other; one at a right angle is all its own."""
    angle, rest = 0.01, torch.zeros(9, 2, dtype=torch.float64)
    theta = torch.zeros(9, 3, dtype=torch.float64)
    theta[0, 0], theta[2, 2] = 1.0, 5.0
    theta[0, 1], theta[1, 1] = 3 * np.cos(angle), 3 * np.sin(angle)
    factor = TriangularFactor((theta, rest))
    xi = torch.tensor([[1.0, 1.0], [1.0, 0.0], [1.0, 1.0]], dtype=torch.float64)
    told = FitReport(PLAIN, xi, factor, 0.0, 9).told_apart()
    assert told[:, 0].tolist() == pytest.approx([np.sin(angle), np.sin(angle), 1.0])
    assert told[:, 1].tolist() == pytest.approx([1.0, 0.0, 1.0])


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


def test_functions_of_a_state_that_no_sensor_sees_are_not_asked_about():
    """Only u is to be excited: nobody can move h by itself, whose samples are a guess."""
    u, x = np.zeros((200, 1)), np.zeros((201, 2))
    for k in range(200):
        x[k + 1] = x[k] + 0.1 * np.array([x[k, 1] - x[k, 0], 1 - x[k, 1] + u[k, 0]])
    x[:, 1] = np.nan
    library, guess = ["y", "h", "1", "u"], {"y": {"y": -1.0, "h": 1.0}, "h": {"h": -1.0, "1": 1.0}}
    refinement = Refinement("trajectory", rounds=0)
    signature = Signature(("y", "h"), ("-", "-"), ("u",), (1.0, 1.0))
    model = SindyModel(signature, library, Regression("bic"), refinement, initial=guess)
    found = model.fit(Transitions.from_trajectory(torch.from_numpy(x), torch.from_numpy(u), 0.1)).identifiability
    assert (found.values["rank"], found.values["count"], found.values["read"]) == (2, 3, ["u"])


def test_small_swings_and_speeds_of_one_sign_are_named():
    x, u = samples()
    swing = Library(SIGNATURE, [CONSTANT, variable("a"), of("sin", "a"), of("cos", "a")])
    small = judge(swing, 1e-4 * x, u)
    assert small.values["condition"] > 1e6 and set(small.values["weakest"]) <= {"1", "a", "sin(a)", "cos(a)"}
    drag = Library(SIGNATURE, [variable("b"), of("abs", "b")])
    one_signed = judge(drag, x.abs(), u)
    assert one_signed.values["rank"] == 1 and set(one_signed.values["weakest"]) == {"b", "|b|"}
    assert judge(drag, x, u).values["rank"] == 2
