"""The examples are plants as docs/extending.md has them, and their rows are what a run says."""

import importlib.util
from pathlib import Path

import pytest
import torch
import yaml

from dynasindy.benchmarks.plants import EXAMPLES, PLANTS, rows_of

ROOT = Path(__file__).parents[2]


def example(name):
    spec = importlib.util.spec_from_file_location("plants", EXAMPLES / "plants.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return getattr(module, name)()


WRITTEN = [name for name, words in PLANTS.items() if words == [f"system={name}"] and name != "swing_up"]


@pytest.mark.parametrize("name", WRITTEN)
def test_each_example_is_a_short_plant_with_a_file(name):
    facts = yaml.safe_load((EXAMPLES / "conf" / "system" / f"{name}.yaml").read_text())
    system = example(facts["system"]["_target_"].partition(".")[2])
    assert set(facts["plant"]["outputs"]) <= set(system.signature.state_names)
    x, u = torch.zeros(3, system.signature.n_x), torch.zeros(3, system.signature.n_u)
    assert system(x, u).shape == x.shape


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


def test_rows_say_what_the_run_says():
    metrics = {
        "held": {"share": {"p": 0.0052, "theta": None}, "worst": {"p": 0.03, "theta": None}},
        "cost": {"plant_seconds": 30.0, "real_steps": 600},
        "evaluation": {"own_return": -212.946},
        "verdict": {"held": "NOT CONTROLLED: errors"},
    }
    first, second = rows_of("cart_pole", 3, metrics, 63.97)
    assert (first["error_percent"], first["worst_percent"], first["cpu_seconds"]) == (0.52, 3.0, 64.0)
    assert first["own_return"] == -212.95
    assert (second["output"], second["error_percent"], second["verdict"]) == ("theta", float("inf"), "NOT CONTROLLED")
    (only,) = rows_of("pendulum_own", 3, metrics | {"held": {"share": {}}, "verdict": {"held": "NOT JUDGED: x"}}, 1.0)
    assert (only["verdict"], only["output"], only["error_percent"]) == ("NOT JUDGED", "", "")
    assert only["own_return"] == -212.95
