"""Margins of large movements: those of a linear loop where there is no friction, and far less than at rest where it is.

The cart on a rail, v' = u under u = 2 (r - p) - k v, moves by 0.4 m.
"""

import numpy as np
import pytest
import torch

from dynasindy.checking.check import Settings, check
from dynasindy.checking.simulation import GAINS, LATEST, has_dry_friction, large_signal_margins
from dynasindy.checking.verdict import check_verdict
from dynasindy.sindy import SindyModel

START = torch.tensor([[-0.2, 0.0], [0.2, 0.0]], dtype=torch.float64)
TARGETS = -START[:, :1]


def stable(k_p, k_v, gain=1.0, later=0, dt=0.1, lift=0.5):
    """Tell whether the sampled loop on a double integrator is stable, its input so many periods late.

    In a period an input lifts the place by `lift` dt^2: of the difference equation of the same changes by nothing.
    """
    a = np.zeros((2 + later, 2 + later))
    b = gain * np.array([lift * dt**2, dt])
    a[:2, :2] = [[1, dt], [0, 1]]
    law = np.array([-k_p, -k_v, *np.zeros(later)])
    if later:
        a[:2, 2] = b
        a[2:-1, 3:] = np.eye(later - 1)
        a[-1] += law
    else:
        a[:2] += np.outer(b, law)
    return np.abs(np.linalg.eigvals(a)).max() < 1


def test_of_a_linear_loop_they_are_those_of_its_eigenvalues(law, loops):
    found = large_signal_margins(loops(law(2.0, 2.5)), START, TARGETS, 40.0)
    late = next(n for n in range(1, 20) if not stable(2.0, 2.5, later=n))
    assert late - 1 - LATEST / 16 <= found.delay <= late
    assert found.gain == GAINS[-1] and stable(2.0, 2.5, gain=float(GAINS[-1]))
    strong = large_signal_margins(loops(law(2.0, 9.0)), START, TARGETS, 40.0)
    edge = next(g for g in np.arange(1.0, 4.0, 0.01) if not stable(2.0, 9.0, gain=g))
    assert edge - 0.135 <= strong.gain <= edge


@pytest.mark.parametrize(("k_p", "k_v"), [(2.0, 1.5), (4.0, 2.5), (2.0, 9.0)])
def test_a_difference_equation_bears_whole_periods_of_delay(law, loops, carts, k_p, k_v):
    """Those with which its characteristic polynomial is stable: 4, 3 and 1 here, and not a part of one more."""
    found = large_signal_margins(loops(law(k_p, k_v), carts(step=0.1)), START, TARGETS, 60.0)
    late = next(n for n in range(1, 20) if not stable(k_p, k_v, later=n, lift=0.0))
    assert found.delay == late - 1
    edge = next((g for g in np.arange(1.0, 4.0, 0.01) if not stable(k_p, k_v, g, lift=0.0)), 4.0)
    assert edge - 0.135 <= found.gain <= edge


def rough(loops, law):
    """Return the cart with little damping but dry friction, by a force of 0.15 at any speed above 1 cm/s."""
    signature = loops().signature
    model = SindyModel(signature, ["force", "v", "tanh(100 v)"], known={"p": "v"})
    xi = [[0.0, 1.0], [1.0, 0.0], [0.0, -0.15]]
    model.set_coefficients(torch.tensor(xi, dtype=torch.float64))
    return loops(law(2.0, 1.2), model=model)


def test_dry_friction_makes_margins_at_rest_that_large_movements_do_not_have(loops, law):
    loop = rough(loops, law)
    found = check(loop, Settings((-0.4,), (0.4,), points=2, seconds=40.0, grid=2, draws=0))
    at_rest = min(margin.delay for target in found.margins for margin in target) / 0.1
    smooth = next(n for n in range(1, 20) if not stable(2.0, 1.2, later=n))  # nothing rubs
    assert smooth - 1 <= found.flown.delay < 0.5 * at_rest
    words = {each.name: each.words for each in check_verdict(found)}["large movements"]
    assert f"or {found.flown.delay:.3g} control periods, {100 * found.flown.delay:.0f} ms, later" in words


def test_a_loop_that_is_lost_as_it_is_has_none(loops, law):
    assert not stable(2.0, 0.05)
    found = large_signal_margins(loops(law(2.0, 0.05)), START, TARGETS, 40.0)
    assert found.gain == found.delay == 0.0


def test_a_plant_without_friction_is_not_flown(loops, law):
    found = check(loops(), Settings((-0.4,), (0.4,), points=2, seconds=4.0, grid=2, draws=0))
    assert found.flown is None and "large movements" not in [each.name for each in check_verdict(found)]
    assert has_dry_friction(rough(loops, law).plant.model) and not has_dry_friction(loops().plant.model)
