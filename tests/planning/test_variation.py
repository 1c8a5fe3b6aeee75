"""Imagined plants that stray from the model."""

import pytest
import torch

from dynasindy.planning import Variation, Varied
from dynasindy.systems.xi import Xi

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


@pytest.mark.parametrize("wrong", [{"parameters": 1.0}, {"disturbance": -0.1}, {"noise": [-1.0]}])
def test_impossible_variations_are_refused(wrong):
    with pytest.raises(ValueError, match=r"mend planning\.variation"):
        Variation(**wrong)


def test_noise_needs_one_deviation_per_state():
    assert Variation().deviations(6) is None
    with pytest.raises(ValueError, match="one per state"):
        Variation(noise=[0.1]).deviations(6)
