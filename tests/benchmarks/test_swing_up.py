"""Agents without a model on swing-ups: how a run is judged, how rows come, and that finished runs stay."""

import math

import pytest
import torch
from benchmarks import swing_up
from benchmarks.arguments import parsed
from benchmarks.swings import SWINGS
from stable_baselines3 import SAC

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
    swing_up.main(parsed("swing_up", command))
    rows = read_rows(out)
    assert [(row["output"], int(row["real_steps"])) for row in rows] == [("c", 20), ("s", 20), ("c", 40), ("s", 40)]
    assert {(row["plant"], row["agent"], row["seed"]) for row in rows} == {("pendulum_v1", agent, "3")}
    assert all(float(row["own_return"]) < -200 and row["held"] == "0" for row in rows)
    swing_up.main(parsed("swing_up", command))
    assert read_rows(out) == rows and "finished before" in capsys.readouterr().out


def test_settings_of_another_plant_are_not_tried(tmp_path, monkeypatch):
    trained = []
    monkeypatch.setattr(swing_up, "train", lambda *job: trained.append(job[:3]))
    swing_up.main(parsed("swing_up", ["--agents", "sac_bullet", "--seeds", "7", "--out", str(tmp_path / "rows.csv")]))
    assert trained == [("swing_up", "sac_bullet", 7)]
    agent = swing_up.build(SWINGS["swing_up"], "sac_bullet", 7)
    assert isinstance(agent, SAC) and agent.use_sde and (agent.gamma, agent.tau) == (0.98, 0.02)  # the zoo's


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
    env, agent = SWINGS["pendulum_v1"].judge(0), swing_up.build(SWINGS["pendulum_v1"], "sac", 0)
    evaluation = swing_up.run(env, Still(agent.action_space, 0.5), SWINGS["pendulum_v1"])
    assert torch.equal(evaluation.inputs, torch.full((2, 200, 1), 0.25))


def test_held_and_upright_are_judged_over_the_last_quarter(short):
    """A pole that stands but for one sample is not upright, nor is one that leans by 0.11 rad."""
    swing = SWINGS["swing_up"]
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


def test_td3_explores_and_settings_are_those_published():
    td3 = swing_up.build(SWINGS["swing_up"], "td3", 0)
    assert td3.action_noise._sigma.tolist() == [0.1] and td3.learning_starts == 100
    td3 = swing_up.build(SWINGS["pendulum_v1"], "td3", 0)
    assert (td3.gamma, td3.learning_starts, td3.learning_rate, td3.buffer_size) == (0.98, 10_000, 1e-3, 200_000)
    sac = swing_up.build(SWINGS["swing_up"], "sac", 0)
    assert (sac.gamma, sac.learning_rate, sac.action_noise) == (0.99, 1e-3, None)
    assert swing_up.build(SWINGS["pendulum_v1"], "sac", 0).learning_rate == 1e-3
