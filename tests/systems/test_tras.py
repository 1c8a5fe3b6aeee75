"""Oracles: the bench's top speeds and its equilibria, from the published tables."""

import dataclasses
import math

import pytest
import torch
from scipy.optimize import fsolve

from dynasindy.systems import Tras, rk4
from dynasindy.systems.tras import TrasConstants


def settle(u, seconds=60):
    x, plant = torch.zeros(6, dtype=torch.float64), Tras()
    for _ in range(int(seconds / 0.01)):
        x = rk4(plant, x, torch.tensor(u, dtype=torch.float64), 0.01)
    return x


def test_rotors_reach_the_speeds_of_the_bench():
    # Bench: 7563/-7339 rpm (tail) and 3857/-3941 rpm (main) at full input; the compact fits keep 3 %.
    plant = Tras()
    for u, tail, main in ((1.0, 7563, 3857), (-1.0, -7339, -3941)):
        x = torch.zeros(6, dtype=torch.float64)
        for _ in range(1500):
            dx = plant(x, torch.tensor([u, u], dtype=torch.float64))
            x = torch.cat([torch.zeros(4, dtype=torch.float64), (x + 0.01 * dx)[4:]])
        assert x[4].item() == pytest.approx(tail, rel=0.03)
        assert x[5].item() == pytest.approx(main, rel=0.03)


def test_free_beam_settles_at_the_published_pitch():
    x = settle([0.0, 0.0])
    assert x[1].item() == pytest.approx(-0.49, abs=0.01)


@pytest.mark.parametrize(("pitch", "u_a", "u_p"), [(-0.5, 0.056, -0.047), (0.0, -0.102, 0.305), (0.4, -0.129, 0.427)])
def test_equilibria_are_those_of_the_bench(pitch, u_a, u_p):
    # The compact fits of the rotor curves move the bench's equilibria by a few hundredths.
    plant = Tras()

    def rates(z):
        x = torch.tensor([0.0, pitch, 0.0, 0.0, z[0] * 1000, z[1] * 1000], dtype=torch.float64)
        u = torch.tensor([z[2], z[3]], dtype=torch.float64)
        return (plant(x, u)[2:] / torch.tensor([1.0, 1.0, 1000.0, 1000.0])).numpy()

    solution, _, found, _ = fsolve(rates, [0.5, 1.0, 0.0, 0.2], full_output=True)
    assert found == 1
    assert solution[2] == pytest.approx(u_a, abs=0.05)
    assert solution[3] == pytest.approx(u_p, abs=0.05)


def test_float32_and_batches_agree_with_float64():
    x = torch.randn(4, 3, 6, dtype=torch.float64) * torch.tensor([1, 1, 1, 1, 3000.0, 1500.0])
    u = torch.rand(4, 3, 2, dtype=torch.float64) * 2 - 1
    plant = Tras()
    single = plant(x.float(), u.float())
    assert single.dtype == torch.float32
    assert torch.allclose(single.double(), plant(x, u), rtol=1e-3, atol=1e-2)
    assert torch.equal(plant(x, u)[1, 2], plant(x[1, 2], u[1, 2]))


def test_every_constant_is_detuned_by_a_factor_of_its_own():
    nominal, other = TrasConstants(), TrasConstants().detuned(0.1, seed=3)
    values = [torch.tensor(dataclasses.astuple(p)[i]).flatten() for p in (other, nominal) for i in range(18)]
    factors = torch.cat(values[:18]) / torch.cat(values[18:])
    assert (factors - 1).abs().max() <= 0.1 + 1e-6 and (factors - 1).abs().mean() > 0.03
    assert factors.unique().numel() == factors.numel() == 24
    assert other == nominal.detuned(0.1, seed=3) != nominal.detuned(0.1, seed=4)


def test_a_detuned_plant_settles_elsewhere():
    # Gravity alone sets the pitch of the free beam, up to the small thrust at u = 0: tan(pitch) = -gravity_c/gravity_s.
    constants = TrasConstants().detuned(0.1, seed=0)
    plant = Tras(constants=constants)
    x = torch.zeros(6, dtype=torch.float64)
    for _ in range(6000):
        x = rk4(plant, x, torch.zeros(2, dtype=torch.float64), 0.01)
    assert x[1].item() == pytest.approx(-math.atan(constants.gravity_c / constants.gravity_s), abs=1e-3)


def test_an_impossible_spread_is_refused():
    with pytest.raises(ValueError, match="spread must be in"):
        TrasConstants().detuned(1.5, seed=0)
