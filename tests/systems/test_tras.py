"""The bench's top speeds and equilibria, its equations by hand, and Lagrange's equations of its beam."""

import math

import pytest
import sympy
import torch
from scipy.optimize import fsolve

from dynasindy.systems import Tras, rk4
from dynasindy.systems.twin_rotor import SIGNATURE, beam_stops, two_branches


def settle(u, seconds=60):
    x, plant = torch.zeros(6, dtype=torch.float64), Tras()
    for _ in range(int(seconds / 0.05)):
        x = rk4(plant, x, torch.tensor(u, dtype=torch.float64), 0.05)
    return x


# States away from rest, with both senses of both rotors: every term of every equation counts at each of them.
POINTS = [
    ([0.3, 0.4, 0.7, -0.5, 3000.0, 1500.0], [0.3, -0.6]),
    ([-1.2, -0.7, -0.9, 0.8, -2500.0, 2000.0], [-0.8, 0.5]),
    ([2.0, 1.1, 1.3, 0.6, 1200.0, -1800.0], [0.9, 0.4]),
    ([0.1, -0.2, -0.4, -1.1, -4100.0, -900.0], [-0.2, -0.3]),
]


def rates(x, u, constants=None):
    return Tras(constants=constants)(
        torch.tensor(x, dtype=torch.float64), torch.tensor(u, dtype=torch.float64)
    ).tolist()


def rotors(x, u):
    """The vendor's rotors, in numbers: thrusts F_h, F_v [N] and accelerations [rpm/s]."""
    w, v = x[4] / 1000, x[5] / 1000
    g_h = 0.0872 * w + 0.00577 * w * w if w >= 0 else 0.0864 * w - 0.00678 * w * w
    g_v = 0.0604 * v + 0.0504 * v * abs(v)
    f_h = 0.01114 * w * w if w >= 0 else -0.02206 * w * w
    f_v = 0.0735 * v * v if v >= 0 else -0.0475 * v * v
    return f_h, f_v, 37000 * (u[0] - g_h), 6100 * (u[1] - g_v)


@pytest.mark.parametrize(("x", "u"), POINTS)
def test_rates_are_those_of_the_vendors_equations_in_plain_numbers(x, u):
    _, pitch, rate_a, rate_p, _, _ = x
    c, s = math.cos(pitch), math.sin(pitch)
    f_h, f_v, tail, main = rotors(x, u)
    azimuth = 0.216 * f_h * c - 0.00588996 * rate_a + 0.01782004 * u[1] * c + 2 * 0.02379038 * s * c * rate_a * rate_p
    gravity = -0.05005756 * c - 0.09360078 * s
    lift = 0.202 * f_v - 0.0127095 * rate_p + gravity - 0.0212485 * rate_a**2 * s * c + 0.00417495 * u[0]
    expected = [rate_a, rate_p, azimuth / (0.02379038 * c**2 + 0.00300962), lift / 0.03005808, tail, main]
    assert rates(x, u) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("x", "u"), POINTS)
def test_the_beam_obeys_lagranges_equations_but_for_the_vendors_centrifugal_term(x, u):
    pitch, rate_a, rate_p = sympy.symbols("pitch rate_a rate_p")
    inertia = 0.02379038 * sympy.cos(pitch) ** 2 + 0.00300962
    kinetic = inertia * rate_a**2 / 2 + 0.03005808 * rate_p**2 / 2
    potential = 0.05005756 * sympy.sin(pitch) - 0.09360078 * sympy.cos(pitch)
    f_h, f_v, _, _ = rotors(x, u)
    push_a = (0.216 * f_h + 0.01782004 * u[1]) * sympy.cos(pitch) - 0.00588996 * rate_a
    push_p = 0.202 * f_v + 0.00417495 * u[0] - 0.0127095 * rate_p
    # d/dt (dT/dq') - dT/dq + dV/dq = Q; the azimuth appears in neither energy.
    turn = (push_a - sympy.diff(kinetic, rate_a, pitch) * rate_p) / inertia
    # Departure of the vendor: 0.0212485 where the kinetic energy asks for 0.02379038.
    vendor = (0.02379038 - 0.0212485) * rate_a**2 * sympy.sin(pitch) * sympy.cos(pitch)
    lift = (push_p + sympy.diff(kinetic - potential, pitch) + vendor) / 0.03005808
    expected = [float(e.subs({pitch: x[1], rate_a: x[2], rate_p: x[3]})) for e in (turn, lift)]
    assert rates(x, u)[2:4] == pytest.approx(expected, rel=1e-10)


def test_rotors_reach_the_speeds_of_the_bench():
    # Bench: 7563/-7339 rpm (tail) and 3857/-3941 rpm (main) at full input; the compact fits keep 3 %.
    plant, u = Tras(), torch.tensor([[1.0, 1.0], [-1.0, -1.0]], dtype=torch.float64)
    x = torch.zeros(2, 6, dtype=torch.float64)
    for _ in range(500):
        x = torch.cat([torch.zeros(2, 4, dtype=torch.float64), (x + 0.02 * plant(x, u))[:, 4:]], -1)
    assert x[:, 4].tolist() == pytest.approx([7563, -7339], rel=0.03)
    assert x[:, 5].tolist() == pytest.approx([3857, -3941], rel=0.03)


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


def test_default_stops_are_those_of_the_vendors_simulation():
    beyond = torch.tensor([[7.0, 2.0, 1.0, 3.0, 4e3, 2e3]], dtype=torch.float64)
    held = torch.tensor([[6.0, 1.5708, 0.0, 0.0, 4e3, 2e3]], dtype=torch.float64)
    for side in (1, -1):
        torch.testing.assert_close(beam_stops().apply(side * beyond)[0], side * held, rtol=0, atol=1e-4)


def test_states_and_inputs_are_the_papers_in_its_order():
    assert SIGNATURE.state_names == ("alpha_a", "alpha_p", "Omega_a", "Omega_p", "omega_a", "omega_p")
    assert SIGNATURE.state_units == ("rad", "rad", "rad/s", "rad/s", "rpm", "rpm")
    assert SIGNATURE.input_names == ("u_a", "u_p")
    assert SIGNATURE.x_scale == (1, 1, 1, 1, 4000, 2500)  # about half of the bench's top speeds
    assert (SIGNATURE.n_x, SIGNATURE.n_u) == (6, 2)


def test_a_rotors_branch_is_chosen_by_its_sense_in_full_precision():
    w = torch.tensor([-2.0, 0.0, 3.0], dtype=torch.float64)
    chosen = two_branches(w, 1.4971e-5, 8.9974e-6)
    assert chosen.dtype == torch.float64
    assert chosen.tolist() == pytest.approx([8.9974e-6, 1.4971e-5, 1.4971e-5], rel=1e-14)
