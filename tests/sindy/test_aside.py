"""What was set aside is the model of the other error, and is fitted by that error from then on."""

import numpy as np
import pytest
import torch

from dynasindy.evaluation.log_fit import take_alternative
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("y",), ("m",), ("u",), (1.0,))


def pushed(samples=400, dt=0.1):
    """A store y' = u - y / 2 + w that w pushes slowly, and whose sensor is noisy."""
    generator, y, w, seen = np.random.default_rng(2), 1.0, 0.0, []
    u = np.repeat(generator.uniform(0, 1, samples // 20), 20)
    for held in u:
        seen.append(y)
        w += -w * dt / 2 + 0.2 * np.sqrt(dt) * generator.normal()
        y += dt * (held - y / 2 + w)
    seen = np.array([*seen, y]) + 0.02 * generator.normal(size=samples + 1)
    return Transitions.from_trajectory(torch.from_numpy(seen)[:, None], torch.from_numpy(u)[:, None], dt)


def model(error):
    refinement = Refinement("trajectory", error=error)
    return SindyModel(SIGNATURE, ["1", "y", "u"], Regression("bic"), refinement)


def test_what_was_set_aside_is_what_one_simulation_finds():
    data = pushed()
    pieces, whole = model("auto"), model("simulation")
    report = pieces.fit(data)
    before = pieces.coefficients.clone()
    expected = whole.fit(data)
    assert report.in_pieces and report.aside is not None
    other, told = take_alternative(pieces, report.aside, data)
    assert torch.equal(other.coefficients, whole.coefficients) and not torch.equal(other.coefficients, before)
    assert torch.equal(pieces.coefficients, before), "the model itself stays"
    assert torch.equal(other.covariance.matrix, whole.covariance.matrix)
    assert told.residual["y"] == pytest.approx(expected.residual["y"], rel=1e-12)
    assert told.in_pieces and told.aside is None and "in one simulation" in " ".join(told.notes)
    assert other.refinement == whole.refinement, "what is fitted anew is fitted by one simulation"


def test_a_log_that_one_simulation_follows_leaves_nothing_aside():
    u = torch.from_numpy(np.repeat(np.random.default_rng(0).uniform(0, 1, 20), 10))[:, None]
    y = [torch.ones(1, dtype=torch.float64)]
    for held in u:
        y.append(2 * held + (y[-1] - 2 * held) * np.exp(-0.05))
    seen = torch.stack(y) + 0.02 * torch.randn(201, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    report = model("auto").fit(Transitions.from_trajectory(seen, u, 0.1))
    assert not report.in_pieces and report.aside is None
