"""Imagined plants that stray from the model."""

import math

import pytest
import torch

from dynasindy.data.simulated import record
from dynasindy.excitation import HeldRandom
from dynasindy.planning import Variation, Varied
from dynasindy.planning.variation import Members
from dynasindy.systems import Tras, Xi
from dynasindy.world_models import Oracle, Regression, SindyModel
from dynasindy.world_models.ensemble import bag

ALL = torch.ones(5, dtype=torch.bool)


def states(rows):
    rng = torch.Generator().manual_seed(1)
    return torch.randn(rows, 6, generator=rng), torch.rand(rows, 2, generator=rng)


def test_no_variation_leaves_the_system():
    varied = Varied(Xi(), Variation(), 5)
    varied.draw(ALL, torch.Generator().manual_seed(0))
    x, u = states(5)
    torch.testing.assert_close(varied(x, u), Xi()(x, u))


def test_rates_and_inputs_are_scaled_by_row_and_angles_stay_integrals_of_their_rates():
    plant, varied = Xi(), Varied(Xi(), Variation(parameters=0.1), 5)
    varied.draw(ALL, torch.Generator().manual_seed(0))
    x, u = states(5)
    dx = varied(x, u)
    torch.testing.assert_close(dx, varied.gain * plant(x, varied.input_gain * u))
    torch.testing.assert_close(dx[:, :2], x[:, 2:4])
    assert float((varied.gain[:, 2:] - 1).abs().min()) > 0
    assert float((varied.gain - 1).abs().max()) <= 0.1 + 1e-6


def test_only_marked_rows_are_drawn_anew():
    varied = Varied(Xi(), Variation(parameters=0.1, disturbance=0.2), 5)
    rng = torch.Generator().manual_seed(0)
    varied.draw(ALL, rng)
    before = varied.drift.clone()
    new = torch.tensor([True, False, True, False, False])
    varied.draw(new, rng)
    changed = (varied.drift != before).any(-1)
    assert changed.tolist() == new.tolist()


def test_disturbances_are_measured_in_ranges_of_the_state():
    varied = Varied(Xi(), Variation(disturbance=0.2), 500)
    varied.draw(torch.ones(500, dtype=torch.bool), torch.Generator().manual_seed(0))
    reach = varied.drift.abs().amax(0)
    torch.testing.assert_close(reach, 0.2 * torch.tensor([0, 0, 1.0, 1.0, 4000.0, 2500.0]), rtol=0.05, atol=0)


def test_each_member_moves_its_share_of_the_rows():
    x, u = states(5)
    moved = Members([Xi(), Tras()])(x, u)
    torch.testing.assert_close(moved, torch.cat([Xi()(x[:3], u[:3]), Tras()(x[3:], u[3:])]))


def test_members_are_fits_to_resampled_data():
    inputs = HeldRandom(2, duration=5.0, amplitude=(0.6, 0.45), offset=(-0.12, 0.21), seed=0).samples(0.01)
    data = record(Xi(), inputs, dt=0.01)
    model = SindyModel(Xi().signature, "paper_table", Regression("bic"))
    members = Members.of(model, data, 2)
    fits = bag(model, data, 2).members
    assert not torch.equal(fits[0], fits[1])
    assert all(torch.equal(member.coefficients, fit) for member, fit in zip(members.models, fits))


def test_a_plant_that_was_not_fitted_has_no_members():
    with pytest.raises(TypeError, match="leave members at 0"):
        Members.of(Oracle(Xi().signature, Xi()), record(Xi(), torch.zeros(10, 2), dt=0.01), 2)


IMPOSSIBLE = [{"parameters": 1.0}, {"disturbance": -0.1}, {"noise": [-1.0]}, {"members": -1}]
IMPOSSIBLE += [{name: math.nan} for name in ("parameters", "disturbance")] + [{"disturbance": math.inf}]
IMPOSSIBLE += [{"noise": [0.1, number]} for number in (math.nan, math.inf)] + [{"noise": [math.nan] * 6}]


@pytest.mark.parametrize("wrong", IMPOSSIBLE)
def test_impossible_variations_are_refused(wrong):
    with pytest.raises(ValueError, match=r"mend planning\.variation"):
        Variation(**wrong)


def test_noise_needs_one_deviation_per_state():
    assert Variation().deviations(6) is None
    with pytest.raises(ValueError, match="one per state"):
        Variation(noise=[0.1]).deviations(6)
