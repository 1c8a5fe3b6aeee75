"""Agents without a model: on what they learn, what they leave behind, and that finished runs stay."""

import json
from pathlib import Path

import pytest
import torch
from benchmark import parse
from benchmarks import model_free
from benchmarks.gradient import PLANTS
from benchmarks.model_free import Job
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from dynasindy.dyna.excite import interact
from dynasindy.evaluation.ablation import read_ablation
from dynasindy.tasks import Tracking

CONF = Path(__file__).resolve().parents[2] / "conf"


@pytest.fixture
def short(monkeypatch):
    """Episodes of 8 periods, an evaluation of 2 references and 4 periods, an excitation of 4 periods."""
    monkeypatch.setattr(model_free, "Tracking", lambda *a, **k: Tracking(*a, **k, max_steps=8))
    scenario, chirp, steps = model_free.Scenario, model_free.Chirp, model_free.step_references
    monkeypatch.setattr(model_free, "step_references", lambda low, high, n: steps(low, high, 2))
    monkeypatch.setattr(model_free, "Scenario", lambda name, reference, n: scenario(name, reference, 2, 0.2))
    monkeypatch.setattr(model_free, "Chirp", lambda n_u, **k: chirp(n_u, duration=0.2, **k))


def options(tmp_path, *more):
    return ["--plants", "xi", "--out", str(tmp_path / "runs"), "--results", str(tmp_path / "results"), *more]


@pytest.mark.parametrize("plant", ["xi", "tras"])
def test_plant_task_reward_and_excitation_are_those_of_the_ablation(plant):
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose("ablation", overrides=[f"system={plant}"])
    system = instantiate(cfg.system)
    task = instantiate(cfg.task, _convert_="all")(signature=system.signature)
    theirs = instantiate(cfg.env, _convert_="all")(system=system, task=task, seed=5)
    mine = model_free.build_env(PLANTS[plant], 5)
    excitation = instantiate(cfg.excitation, _convert_="all")(n_u=2, dt=theirs.dt)
    agent = model_free.build_agent(Job(plant, "td3", 0, 1), model_free.build_env(PLANTS[plant], 5))
    model_free.excite(agent, mine, PLANTS[plant])
    rollout = interact(theirs, excitation, excitation.n_steps)
    n = len(rollout)
    assert n == 200 == model_free.stored(agent)
    buffer = agent.replay_buffer
    assert buffer.observations[:n, 0] == pytest.approx(rollout["observation"].numpy())
    assert buffer.next_observations[:n, 0] == pytest.approx(rollout["next", "observation"].numpy())
    assert buffer.actions[:n, 0] == pytest.approx(rollout["action"].numpy())
    assert buffer.rewards[:n] == pytest.approx(rollout["next", "reward"].numpy())
    assert not buffer.dones[:n].any()
    torch.manual_seed(0)
    full_range = torch.rand(50, 2) * 2 - 1
    flights = [env.reset().clone() for env in (mine, theirs)]
    for u in full_range:  # hard flights, so that stops, bonus and far errors are met
        flights = [env.step_mdp(env.step(now.set("action", u))) for env, now in zip((mine, theirs), flights)]
    assert torch.equal(flights[0]["observation"], flights[1]["observation"])
    assert mine.task.max_steps == theirs.task.max_steps and mine.task.reward_function == theirs.task.reward_function
    scenario = instantiate(cfg.scenario, _convert_="all")
    facts = PLANTS[plant]
    assert torch.equal(
        scenario.reference.sample(torch.Size((64,)), None),
        model_free.step_references(facts.low, facts.high, 64).sample(torch.Size((64,)), None),
    )
    # None is the length of an episode, 400 periods of 0.05 s.
    assert (scenario.name, scenario.episodes, scenario.seconds or 400 * 0.05) == ("step", 64, 20.0)
    assert instantiate(cfg.level) == model_free.Level()


@pytest.mark.parametrize(("agent", "updates"), [("sac", 8), ("sac_5", 40), ("td3", 8), ("td3_5", 40)])
def test_each_agent_learns_from_the_first_period_on_and_leaves_a_row_per_episode(short, tmp_path, agent, updates):
    model_free.main(parse("model_free", options(tmp_path, "--agents", agent, "--seeds", "3", "--episodes", "2")))
    curves = read_ablation(tmp_path / "results" / "ablation_curves.csv")
    assert [(row["setting"], row["seed"], row["episode"]) for row in curves] == [(f"sb3_{agent}", 3, n) for n in (1, 2)]
    assert [row["updates"] for row in curves] == [updates, 2 * updates]
    assert [row["real_steps"] for row in curves] == [12, 20]
    assert [row["plant_seconds"] for row in curves] == pytest.approx([0.6, 1.0])
    assert all(row["imagined_transitions"] == 0 and row["reward_error"] is None for row in curves)
    assert curves[0]["evaluated_steady_state_error/alpha_a"] != curves[1]["evaluated_steady_state_error/alpha_a"]
    (run,) = read_ablation(tmp_path / "results" / "ablation.csv")
    worst = max(curves[1][f"evaluated_steady_state_error/{axis}"] for axis in ("alpha_a", "alpha_p"))
    assert run["steady_state_error"] == pytest.approx(worst, rel=1e-5)
    assert (tmp_path / "results" / "ablation.md").read_text().count(f"sb3_{agent} | 1 |") == 1


def test_finished_runs_are_not_repeated_and_others_are_refused_before_anything_runs(tmp_path, monkeypatch, capsys):
    learned = []

    def learn(job, folder):
        learned.append((job.agent, job.seed))
        (folder / "progress.csv").write_text("episode\n" + "1\n" * (2 if len(learned) == 2 else 4))
        if len(learned) == 2:
            raise KeyboardInterrupt
        return {"seed": job.seed, "evaluation": {"steady_state_error/y": 0.5}, "cost": {"wall_seconds": 1.0}}

    monkeypatch.setattr(model_free, "learn", learn)
    monkeypatch.setattr(model_free, "gather", lambda *a: None)
    monkeypatch.setattr(model_free, "draw_ablation", lambda *a: None)
    command = options(tmp_path, "--agents", "sac", "td3", "--seeds", "0", "--episodes")
    with pytest.raises(KeyboardInterrupt):
        model_free.main(parse("model_free", [*command, "4"]))
    first, second = (Job("xi", agent, 0, 4).folder(tmp_path / "runs") for agent in ("sac", "td3"))
    assert not (second / "metrics.json").exists()
    model_free.main(parse("model_free", [*command, "4"]))
    model_free.main(parse("model_free", [*command, "4"]))
    assert learned == [("sac", 0), ("td3", 0), ("td3", 0)]
    (second / "metrics.json").write_text("")  # as a full disk leaves it
    model_free.main(parse("model_free", [*command, "4"]))
    assert learned[3:] == [("td3", 0)]
    with pytest.raises(SystemExit):
        model_free.main(parse("model_free", [*command, "5", "--seeds", "1", "0"]))
    assert "episodes: 5" in capsys.readouterr().err and len(learned) == 4
    assert set(json.loads((first / "origin.json").read_text())) == {"command", "commit"}
