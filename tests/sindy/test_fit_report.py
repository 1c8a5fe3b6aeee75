"""A report's figures are those of the samples."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dynasindy.sindy.covariance import Covariance
from dynasindy.sindy.fit_report import FitReport
from dynasindy.sindy.library import CONSTANT, Library, variable
from dynasindy.sindy.regression import TriangularFactor
from dynasindy.systems.base import Signature

LIBRARY = Library(Signature(("a", "b"), ("rad", "rad/s"), ("u",), (1.0, 1.0)), [CONSTANT, variable("a"), variable("u")])
XI = torch.tensor([[0.0, 1.0], [2.0, 0.0], [0.0, -1.0]], dtype=torch.float64)


def rows(seed: int = 0, noise: float = 0.3) -> tuple[torch.Tensor, torch.Tensor]:
    generator = np.random.default_rng(seed)
    theta = LIBRARY(torch.from_numpy(generator.normal(size=(90, 2))), torch.from_numpy(generator.normal(size=(90, 1))))
    return theta, theta @ XI + noise * torch.from_numpy(generator.normal(size=(90, 2)))


def report(data) -> tuple[FitReport, TriangularFactor]:
    factor = TriangularFactor(data)
    return FitReport(LIBRARY, XI, factor, 0.25, 90, dt=0.01), factor


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
    stepped = replace(FitReport(LIBRARY.with_step(0.01), XI, factor, 0.25, 90, dt=0.01), covariance=known)
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
    told = FitReport(LIBRARY, xi, factor, 0.0, 9).told_apart()
    assert told[:, 0].tolist() == pytest.approx([np.sin(angle), np.sin(angle), 1.0])
    assert told[:, 1].tolist() == pytest.approx([1.0, 0.0, 1.0])
