"""Agents without a model on swing-ups: how a run is judged, how rows come, and that finished runs stay."""

import math
import sys
from pathlib import Path

import pytest
import torch
from benchmark import parse
from benchmarks import swing_up
from benchmarks.plants import EXAMPLES, PLANTS
from benchmarks.swing_up import TASKS, BoundedEpisodes
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import open_dict

from dynasindy.safe_io import read_rows


@pytest.fixture
def short(monkeypatch):
    """Two evaluations of two episodes, one every 20 real steps."""
    monkeypatch.setattr(swing_up, "EVERY", 20)
    monkeypatch.setattr(swing_up, "EPISODES", 2)


class Still:
    """An agent that gives one input, in the units of Pendulum-v1."""

    def __init__(self, space, value=0.0):
        self.action_space, self.value = space, value

    def predict(self, seen, deterministic):
        assert deterministic
        return torch.full((len(seen), 1), self.value).numpy(), None


@pytest.mark.parametrize("agent", ["sac", "td3"])
def test_rows_come_as_the_run_goes_on_and_a_finished_run_stays(short, tmp_path, agent, capsys):
    out = tmp_path / "rows.csv"
    command = ["--plants", "pendulum_v1", "--agents", agent, "--seeds", "3", "--steps", "40", "--out", str(out)]
    swing_up.main(parse("swing_up", command))
    rows = read_rows(out)
    assert [(row["output"], int(row["real_steps"])) for row in rows] == [("c", 20), ("s", 20), ("c", 40), ("s", 40)]
    assert {(row["plant"], row["agent"], row["seed"]) for row in rows} == {("pendulum_v1", agent, "3")}
    assert all(float(row["own_return"]) < -200 and row["held"] == "0" for row in rows)
    swing_up.main(parse("swing_up", command))
    assert read_rows(out) == rows and "finished before" in capsys.readouterr().out


def test_a_run_that_was_stopped_is_made_anew_and_one_that_held_is_not(tmp_path):
    out = tmp_path / "rows.csv"
    row = dict.fromkeys(swing_up.COLUMNS, "1") | {"plant": "swing_up", "agent": "sac", "held": "0"}
    held = row | {"seed": "2", "held": "1"}
    swing_up.append_rows(out, swing_up.COLUMNS, [row, held])
    job = {"plant": "swing_up", "agent": "sac"}
    assert swing_up.is_finished(out, job | {"seed": "2"}, 40)
    assert not swing_up.is_finished(out, job | {"seed": "1"}, 40)
    assert read_rows(out) == [held]


def test_a_run_ends_where_the_plant_is_held(short, tmp_path, monkeypatch):
    told = iter([0, 1])
    monkeypatch.setattr(swing_up, "rows_of", lambda *a: [{"output": "p", "held": next(told)}])
    monkeypatch.setattr(swing_up, "run", lambda *a: None)
    swing_up.train("pendulum_v1", "sac", 0, 200, tmp_path / "rows.csv")
    assert [row["real_steps"] for row in read_rows(tmp_path / "rows.csv")] == ["20", "40"]


def test_an_agent_acts_in_the_units_of_its_environment(short):
    """Pendulum-v1 has torques of -2 to 2, so that half of it is an action of 0.25 of the half range."""
    env, agent = TASKS["pendulum_v1"].judge(0), swing_up.build(TASKS["pendulum_v1"], "sac", 0)
    evaluation = swing_up.run(env, Still(agent.action_space, 0.5), TASKS["pendulum_v1"])
    assert torch.equal(evaluation.inputs, torch.full((2, 200, 1), 0.25))


def test_held_and_upright_are_judged_over_the_last_quarter(short):
    """A pole that stands but for one sample is not upright, nor is one that leans by 0.11 rad."""
    swing = TASKS["swing_up"]
    agent = swing_up.build(swing, "sac", 0)
    evaluation = swing_up.run(swing.judge(0), agent, swing)
    states = evaluation.trajectory["state"]
    assert states.shape == (2, 400, 4) and float(states[:, 0, 1].sub(math.pi).abs().max()) <= 0.11
    for angle, sample, upright, held in (
        (0.0, None, 1, 1),
        (2 * math.pi, None, 1, 0),
        (0.09, None, 1, 0),
        (0.11, None, 0, 0),
        (0.0, 300, 0, 0),
        (0.0, 299, 1, 1),
    ):
        states[:], states[..., 1] = 0.0, angle
        if sample is not None:
            states[1, sample, 1] = 100.0
        first, second = swing_up.rows_of(swing, evaluation)
        assert (first["upright"], first["held"], first["own_return"]) == (upright, held, ""), (angle, sample)
        assert (first["output"], second["output"], float(first["error_percent"])) == ("p", "theta", 0.0)
    states[:], states[0, :, 0] = 0.0, 0.15  # the box of a position is its range of 1.5 m
    row = swing_up.rows_of(swing, evaluation)[0]
    assert (row["error_percent"], row["worst_percent"], row["held"]) == ("5", "10", 0)


CONF = Path(__file__).resolve().parents[2] / "conf"


@pytest.mark.parametrize("name", TASKS)
def test_plant_and_task_are_those_of_the_command(name, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(EXAMPLES), *sys.path])
    with initialize_config_dir(str(CONF), version_base="1.3"):
        search = [f"hydra.searchpath=[file://{EXAMPLES / 'conf'}]"]
        cfg = compose("train", overrides=[*search, *PLANTS[name]])
    with open_dict(cfg):
        cfg.folder = "unused"
    system = instantiate(cfg.system)
    task = instantiate(cfg.task, _convert_="all")(signature=system.signature)
    theirs, mine = instantiate(cfg.env, _convert_="all")(system=system, task=task, seed=5), TASKS[name].judge(5)
    assert mine.system.signature.x_scale == theirs.system.signature.x_scale and mine.dt == theirs.dt
    assert mine.task.max_steps == theirs.task.max_steps and TASKS[name].within == cfg.evaluation.within
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
    env = BoundedEpisodes(TASKS["swing_up"].judge(0))
    env.reset(seed=0)
    ended = []
    for n in range(1, 20):
        *_, terminated, truncated, info = env.step(torch.ones(1).numpy())
        assert truncated == (abs(info["state"][0]) > 2.4) and not terminated
        ended += [n] * truncated
    assert ended[0] * 0.05 == pytest.approx(0.73, abs=0.1)


def test_angles_are_counted_from_upright():
    pendulum, cart_pole = (TASKS[name].angle for name in ("pendulum_v1", "swing_up"))
    leaning = torch.tensor([math.cos(-0.3), math.sin(-0.3), 5.0])
    assert float(pendulum(leaning)) == pytest.approx(-0.3, abs=1e-6)
    for turns in (-1, 0, 2):
        state = torch.tensor([1.0, 2 * math.pi * turns + 0.2, 0.0, 0.0])
        assert float(cart_pole(state)) == pytest.approx(0.2, abs=1e-5)
