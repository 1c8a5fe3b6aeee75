"""The command trains plants as a new user does; the plants of docs/examples move as physics says."""

import importlib.util
import json
import math

import pytest
import torch
import yaml
from benchmark import parse
from benchmarks import plants
from benchmarks.plants import EXAMPLES, MEASURED, PLANTS

from dynasindy.safe_io import read_rows


def test_rows_say_what_the_run_says(tmp_path, monkeypatch):
    metrics = {
        "held": {"share": {"p": 0.0052, "theta": None}, "worst": {"p": 0.03, "theta": None}},
        "cost": {"plant_seconds": 30.0, "real_steps": 600},
        "evaluation": {"own_return": -212.946},
        "verdict": {"controlled": False},
    }

    def trained(command, words, folder, result, modules):
        assert command == "train" and {"system=cart_pole", "seed=3"} <= set(words) and modules == [EXAMPLES]
        result.parent.mkdir()
        result.write_text(json.dumps(metrics))
        return 63.97

    monkeypatch.setattr(plants, "run_command", trained)
    out = tmp_path / "plants.csv"
    plants.main(parse("plants", ["--plants", "cart_pole", "--seeds", "3", "--out", str(out)]))
    metrics |= {"held": {"share": {}}, "verdict": {"controlled": None}}
    monkeypatch.setitem(PLANTS, "pendulum_own", PLANTS["cart_pole"])
    plants.main(parse("plants", ["--plants", "pendulum_own", "--seeds", "3", "--out", str(out)]))
    first, second, only = read_rows(out)
    assert tuple(first) == plants.COLUMNS
    assert (first["error_percent"], first["worst_percent"], first["cpu_seconds"]) == ("0.52", "3.0", "64.0")
    assert (first["own_return"], first["plant_seconds"], first["periods"]) == ("-212.95", "30.0", "600")
    assert (second["output"], second["error_percent"], second["verdict"]) == ("theta", "inf", "NOT CONTROLLED")
    assert (only["verdict"], only["output"], only["error_percent"]) == ("NOT JUDGED", "", "")


def example(name, file="plants"):
    spec = importlib.util.spec_from_file_location(file, EXAMPLES / f"{file}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return getattr(module, name)()


def more(name, x, u):
    """Return the rates of change of one of the plants that no setting was tuned on."""
    given = (torch.tensor(values, dtype=torch.float64) for values in (x, u))
    return example(name, "more_plants")(*given).tolist()


# Those of another plant's file, or simulated by dm_control.
NOT_OURS = ("swing_up", "furuta_swing_up", "dm_pendulum", "dm_cartpole", "dm_swing_up")


@pytest.mark.parametrize(
    "name", [name for name, words in PLANTS.items() if words == [f"system={name}"] and name not in NOT_OURS]
)
def test_each_example_names_its_states_as_its_file_does(name):
    facts = yaml.safe_load((EXAMPLES / "conf" / "system" / f"{name}.yaml").read_text())
    file, _, target = facts["system"]["_target_"].partition(".")
    system, plant = example(target, file), facts["plant"]
    x, u = torch.zeros(3, system.signature.n_x), torch.zeros(3, system.signature.n_u)
    assert system(x, u).shape == x.shape
    assert {*plant["outputs"], *plant["known"]} <= set(system.signature.state_names)
    if name in MEASURED:  # steps of places and angles, each with a rate that is to be estimated
        assert set(plant["sensors"]) == set(plant["known"])
        assert all(channel["resolution"] > 0 for channel in plant["sensors"].values())


def test_the_examples_rest_where_physics_says():
    """Hover: 2 * 4 (1 + u) N = 9.81 N. Tanks: inflow equals outflow at one level. Upright is a rest of the pole."""
    hover = example("Quadrotor")(torch.zeros(6), torch.full((2,), 9.81 / 8 - 1))
    torch.testing.assert_close(hover, torch.zeros(6), atol=1e-5, rtol=0)
    level = (0.004 * 0.75 / 0.0028) ** 2
    torch.testing.assert_close(example("Tanks")(torch.full((2,), level), torch.tensor([0.5])), torch.zeros(2))
    pole = example("CartPole")
    torch.testing.assert_close(pole(torch.zeros(4), torch.zeros(1)), torch.zeros(4))
    # 3/2 (1 + m_c/m_p ratio) g: alpha = g theta / (l (4/3 - m / M)), with l = 0.5 m, m = 0.1 kg and M = 1.1 kg in all.
    leaning = pole(torch.tensor([0.0, 1e-3, 0.0, 0.0]), torch.zeros(1))
    assert float(leaning[3]) == pytest.approx(9.81e-3 / (0.5 * (4 / 3 - 0.1 / 1.1)), rel=1e-4)
    assert float(example("VanDerPol")(torch.tensor([0.5, 1.0]), torch.tensor([0.1]))[1]) == pytest.approx(1.5)


def test_the_plants_that_nothing_was_tuned_on_rest_where_their_equations_say():
    """Each equality is solved by hand from the equations of textbooks, with the constants of the docstrings."""
    rest = pytest.approx([0.0] * 3, abs=1e-9)
    assert more("Maglev", [10.0, 0.0, 1.0], [0.0]) == rest
    assert more("Maglev", [8.0, 0.0, 0.8], [-0.2]) == rest  # the pull goes as (i / d)^2
    # Steady state of the reactor at 350 K: k = 7.2e10 e^-25, c = 1 / (1 + k), and the jacket takes 209.2 k c.
    k = 7.2e10 * math.exp(-25.0)
    jacket = 350.0 - 209.2 * k / (1 + k) / 2.092
    assert more("Reactor", [1 / (1 + k), 350.0], [(jacket - 300.0) / 20.0]) == pytest.approx([0.0, 0.0], abs=1e-9)
    # A solid ball on a slope: 5/7 g sin(a); on a level beam that turns it is thrown outwards.
    assert more("BallOnBeam", [0.2, 0.0, -0.1, 0.0], [0.0])[1] == pytest.approx(5 / 7 * 9.81 * math.sin(0.1))
    assert more("BallOnBeam", [0.2, 0.0, 0.0, 3.0], [0.0])[1] == pytest.approx(5 / 7 * 0.2 * 9.0)
    assert more("Arm", [0.3, 0.0], [0.4 * math.sin(0.3)]) == pytest.approx([0.0, 0.0], abs=1e-9)
    assert more("Arm", [0.0, 1.0], [0.0])[1] == pytest.approx(-3.0)
    assert more("Ship", [0.7, 0.01, 0.26], [0.26 / 0.6]) == pytest.approx([0.01, 0.0, 0.0], abs=1e-9)
    # Pushed with 4 N and at rest, no spring but the wall's is bent: 5 N/m.
    assert more("Springs", [0.8, 0.8, 0.8, 0.0, 0.0, 0.0], [0.5]) == pytest.approx([0.0] * 6, abs=1e-9)
    assert more("Springs", [0.0, 0.5, 0.5, 0.0, 0.0, 0.0], [0.0])[3:] == pytest.approx([11.25, -11.25, 0.0])
    wall = (20.0 / 5400 + 5.0 / 10800) / (1 / 5400 + 1 / 10800)
    assert more("Room", [20.0, wall], [(20.0 - wall) / 9.0 - 1]) == pytest.approx([0.0, 0.0], abs=1e-12)
    # An ideal boost converter at a duty of 0.5 would give 24 V; 2.4 A through 0.1 ohm leave 0.24 V less on its coil.
    assert more("Boost", [2.4, 24.0], [0.0]) == pytest.approx([-240.0, 0.0])
    assert more("Bioreactor", [3.7, 0.6], [(0.5 * 0.6 / 1.4 - 0.15) / 0.12]) == pytest.approx([0.0, 0.0], abs=1e-9)


def test_four_tanks_keep_their_water_and_flow_as_torricelli_says():
    x, u = [12.0, 13.0, 1.5, 2.0], [0.1, -0.2]
    pumped = 3.34 * 3.0 * (1.1 + 0.8)
    lower = 0.071 * math.sqrt(2 * 981 * 12.0) + 0.057 * math.sqrt(2 * 981 * 13.0)
    stored = sum(area * rate for area, rate in zip((28.0, 32.0, 28.0, 32.0), more("FourTanks", x, u), strict=True))
    assert stored == pytest.approx(pumped - lower)
    assert more("FourTanks", x, u)[2] == pytest.approx((0.4 * 10.02 * 0.8 - 0.071 * math.sqrt(2 * 981 * 1.5)) / 28.0)


@pytest.mark.parametrize(
    ("name", "mass", "height"),
    [
        ("Balancer", lambda c: [[5.0, 1.2 * c], [1.2 * c, 0.76]], 1.2 * 9.81),
        ("Furuta", lambda c: [[8.5e-4 + 1.3e-4 * (1 - c * c), 1.3e-4 * c], [1.3e-4 * c, 1.3e-4]], 0.0152),
    ],
)
def test_what_swings_freely_changes_its_energy_by_what_friction_and_motor_do(name, mass, height):
    """The power of motor and friction is the rate of q'Mq'/2 + height cos(angle), by Lagrange."""
    generator = torch.Generator().manual_seed(0)
    for _ in range(5):
        a, b, v, w = torch.randn(4, generator=generator, dtype=torch.float64).tolist()
        u = 0.3
        _, _, dv, dw = more(name, [a, b, v, w], [u])

        def _energy(t, b=b, v=v, w=w, dv=dv, dw=dw):
            rates = torch.tensor([v + t * dv, w + t * dw], dtype=torch.float64)
            angle = b + t * w
            matrix = torch.tensor(mass(math.cos(angle)), dtype=torch.float64)
            return float(rates @ matrix @ rates) / 2 + height * math.cos(angle)

        power = (_energy(1e-5) - _energy(-1e-5)) / 2e-5
        if name == "Balancer":
            torque = 6.0 * u - 0.2 * (v / 0.1 - w)
            given = torque * (v / 0.1 - w)
        else:
            given = (0.005 * (10.0 * u - 0.042 * v) - 2e-4 * v) * v - 5e-5 * w * w
        assert power == pytest.approx(given, rel=1e-5, abs=1e-8)
