"""Swing-ups for agents without a model are those that the library's own runs have."""

import math
import sys
from pathlib import Path

import pytest
import torch
from benchmarks.plants import EXAMPLES, PLANTS
from benchmarks.swings import SWINGS, Fenced
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import open_dict

CONF = Path(__file__).resolve().parents[2] / "conf"


@pytest.mark.parametrize("name", SWINGS)
def test_plant_and_task_are_those_of_the_command(name, monkeypatch):
    if name in ("double_pendulum", "reacher"):
        pytest.importorskip("mujoco")
    monkeypatch.setattr(sys, "path", [str(EXAMPLES), *sys.path])
    with initialize_config_dir(str(CONF), version_base="1.3"):
        search = [f"hydra.searchpath=[file://{EXAMPLES / 'conf'}]"]
        cfg = compose("train", overrides=[*search, *PLANTS[name]])
    with open_dict(cfg):
        cfg.folder = "unused"
    system = instantiate(cfg.system)
    task = instantiate(cfg.task, _convert_="all")(signature=system.signature)
    theirs, mine = instantiate(cfg.env, _convert_="all")(system=system, task=task, seed=5), SWINGS[name].judge(5)
    assert mine.system.signature.x_scale == theirs.system.signature.x_scale and mine.dt == theirs.dt
    assert mine.task.max_steps == theirs.task.max_steps and SWINGS[name].within == cfg.evaluation.within
    assert torch.equal(mine.task.boxes(), theirs.task.boxes())
    assert all(map(torch.equal, mine.task.bounds, theirs.task.bounds))
    assert mine.task.reward_function == theirs.task.reward_function
    flights = [env.reset().clone() for env in (mine, theirs)]
    for u in torch.linspace(-1, 1, 30).unsqueeze(-1).expand(-1, len(system.signature.input_names)):
        flights = [env.step_mdp(env.step(now.set("action", u))) for env, now in zip((mine, theirs), flights)]
        assert torch.equal(flights[0]["observation"], flights[1]["observation"])
        if flights[0]["done"]:
            break


def test_an_episode_ends_at_the_end_of_the_track_without_being_over():
    """Ten newtons on 1.1 kg reach 2.4 m after 0.73 s, which pole and damping change little."""
    env = Fenced(SWINGS["swing_up"].judge(0))
    env.reset(seed=0)
    ended = []
    for n in range(1, 20):
        *_, terminated, truncated, info = env.step(torch.ones(1).numpy())
        assert truncated == (abs(info["state"][0]) > 2.4) and not terminated
        ended += [n] * truncated
    assert ended[0] * 0.05 == pytest.approx(0.73, abs=0.1)


def test_angles_are_counted_from_upright():
    pendulum, cart_pole, double = (SWINGS[name].angle for name in ("pendulum_v1", "swing_up", "double_pendulum"))
    both = torch.tensor([[0.3, 0.1, -0.3, 9.0, 9.0, 9.0], [0.3, -0.2, 0.2, 0.0, 0.0, 0.0]])  # the upper one from there
    assert double(both).tolist() == pytest.approx([0.2, 0.2])
    leaning = torch.tensor([math.cos(-0.3), math.sin(-0.3), 5.0])
    assert float(pendulum(leaning)) == pytest.approx(-0.3, abs=1e-6)
    for turns in (-1, 0, 2):
        state = torch.tensor([1.0, 2 * math.pi * turns + 0.2, 0.0, 0.0])
        assert float(cart_pole(state)) == pytest.approx(0.2, abs=1e-5)


def test_the_double_pendulum_shows_its_states_as_its_environment_does():
    pytest.importorskip("mujoco")
    swing = SWINGS["double_pendulum"]
    env, bare = swing.judge(3), swing.learn()
    now = env.reset()
    begun = env.copies.pool[0].unwrapped
    for _ in range(3):
        torch.testing.assert_close(swing.seen(now["state"]), torch.from_numpy(begun._get_obs()), atol=1e-6, rtol=1e-6)
        now = env.step_mdp(env.step(now.set("action", torch.ones(1))))
    assert bare.observation_space.shape == (9,)
