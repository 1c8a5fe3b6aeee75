"""A reward out of what was paid, against rewards written down by hand."""

import copy
import math
from functools import partial

import pytest
import torch
from recipes import Heard, make_recipe

from dynasindy.dyna.loop import LoopSettings, train
from dynasindy.envs import Foreign, GymnasiumEnv, Multisine
from dynasindy.planning import GradientPlanning, ImaginedReplay
from dynasindy.sindy import LearnedReward, SindyModel
from dynasindy.systems import Diverged, Signature

SIGNATURE = Signature(("a", "b"), ("m", "m"), ("u",), (2.0, 4.0))
FREE = torch.tensor(False)
PENDULUM = ["1", "c", "c^2", "c^3", "sqrt(c - -1)", "c sqrt(c - -1)", "w^2", "torque^2"]


def drawn(rows=300, seed=0):
    generator = torch.Generator().manual_seed(seed)
    x, x_next, u = (torch.randn(rows, n, generator=generator).double() for n in (2, 2, 1))
    return x, u.clamp(-1.0, 1.0), x_next


def earned(task, x, u, x_next):
    return task.earned(x, u, x_next, torch.zeros(0), torch.zeros(1), FREE)


@pytest.mark.parametrize("later", [False, True])
def test_a_reward_of_either_end_of_the_period_is_found(later):
    x, u, x_next = drawn()
    a, b = (x_next if later else x).unbind(-1)
    paid = 3.0 - 2.0 * a**2 + 0.5 * a * b - 0.1 * u[:, 0] ** 2
    task = LearnedReward(SIGNATURE)
    assert not earned(task, x, u, x_next).any()  # nothing is known yet
    task.learn(x, u, x_next, paid)
    torch.testing.assert_close(earned(task, *drawn(20, 1)), _by_hand(*drawn(20, 1), later), atol=1e-6, rtol=1e-6)
    assert task.summary().startswith("3 - 2 a^2 + 0.5 a b - 0.1 u^2,") and ("at the end" in task.summary()) == later
    assert task.unit == pytest.approx(float(paid.std()))


def _by_hand(x, u, x_next, later):
    a, b = (x_next if later else x).unbind(-1)
    return 3.0 - 2.0 * a**2 + 0.5 * a * b - 0.1 * u[:, 0] ** 2


def test_what_a_library_cannot_express_is_refused_and_changes_nothing():
    x, u, x_next = drawn()
    task = LearnedReward(SIGNATURE)
    task.learn(x, u, x_next, x[:, 0])
    before = earned(task, x, u, x_next)
    with pytest.raises(Diverged, match="10 %"):
        task.learn(x, u, x_next, torch.sin(9.0 * x[:, 0]))
    assert torch.equal(earned(task, x, u, x_next), before)
    # What is left over is counted in deviations: a wave of a twelfth of them passes, of a fifth it does not.
    scale = float(x[:, 0].std()) * math.sqrt(2)
    task.learn(x, u, x_next, x[:, 0] + scale / 12 * torch.sin(40.0 * x[:, 0]))
    with pytest.raises(Diverged):
        task.learn(x, u, x_next, x[:, 0] + scale / 5 * torch.sin(40.0 * x[:, 0]))


def test_a_given_reward_is_used_and_compared_with_what_was_paid():
    x, u, x_next = drawn()

    def reward(x, u, x_next):
        return x[..., 0] - 2.0 * x_next[..., 1] * u[..., 0]

    task = LearnedReward(SIGNATURE, reward)
    torch.testing.assert_close(earned(task, x, u, x_next), x[:, 0] - 2.0 * x_next[:, 1] * u[:, 0])
    task.learn(x, u, x_next, reward(x, u, x_next))
    assert "leaves 0 %" in task.summary()
    off = reward(x, u, x_next)
    task.learn(x, u, x_next, off + 0.5 * off.std())  # half a deviation beside it, everywhere
    assert "50 %" in task.summary()


def test_what_was_learnt_is_kept():
    x, u, x_next = drawn()
    task, other = LearnedReward(SIGNATURE), LearnedReward(SIGNATURE)
    task.learn(x, u, x_next, x_next[:, 1] ** 2 - u[:, 0])
    other.load_state_dict(copy.deepcopy(task.state_dict()))
    assert torch.equal(earned(other, x, u, x_next), earned(task, x, u, x_next))
    assert (other.summary(), other.unit) == (task.summary(), task.unit)


def of_pendulum(planning, seed=0):
    """Return the parts of an experiment on Pendulum-v1 under its own reward."""
    system = Foreign("Pendulum-v1", {"c": 1.0, "s": 1.0, "w": 8.0}, ["torque"], stops=["w"])
    products = ["1", "c", "s", "w", "torque", "c s", "c w", "s w", "s^2", "c torque", "s torque"]
    return make_recipe(
        system,
        task=partial(LearnedReward, library=PENDULUM, max_steps=60),
        env=GymnasiumEnv,
        excitation=partial(Multisine, duration=3.0, amplitude=1.0, seed=seed),
        world_model=partial(SindyModel, library=products),
        planning=planning,
        train=LoopSettings(1, 0.1),
        seed=seed,
    ).build()


@pytest.mark.parametrize(
    "planning",
    [
        partial(ImaginedReplay, rollouts=4, horizon=3),
        partial(GradientPlanning, updates=2, more_updates=1, rollouts=4, window=5, searches=1),
    ],
    ids=["dyna", "gradient"],
)
def test_pendulum_v1_pays_itself_and_both_planners_imagine_it(planning):
    """-(angle^2 + 0.1 w^2 + 0.001 torque^2) of the state at the start, as Gymnasium documents it; torques up to 2."""
    parts = of_pendulum(planning)
    assert parts.model_env.task is parts.plant.task
    heard = Heard()
    train(parts, LoopSettings(1, 0.1), heard)
    for rows in (heard.excited, *(episode.rollout for episode in heard.episodes)):
        angle = torch.atan2(rows["state"][:, 1], rows["state"][:, 0])
        torque = 2.0 * rows["action"][:, 0].clamp(-1.0, 1.0)
        paid = -(angle**2 + 0.1 * rows["state"][:, 2] ** 2 + 0.001 * torque**2)
        torch.testing.assert_close(rows["next", "reward"][:, 0].double(), paid, rtol=1e-4, atol=1e-4)
        assert torch.equal(rows["next", "reward"], rows["next", "own_reward"])
    x = torch.tensor([[math.cos(k), math.sin(k), 2.0] for k in (0.0, 0.5, -1.0, 2.0)])
    u = torch.tensor([[0.0], [1.0], [-1.0], [0.5]])
    imagined = parts.model_env.step(parts.model_env.start_from(x).set("action", u))["next", "reward"]
    by_hand = -(torch.tensor([0.0, 0.5, -1.0, 2.0]) ** 2 + 0.4)
    torch.testing.assert_close(imagined[:, 0], by_hand, rtol=0, atol=0.35)
    again = of_pendulum(planning)
    again.load_state_dict(parts.state_dict())
    assert again.plant.task.summary() == parts.plant.task.summary() != ""
