"""The evaluation script on a run folder that holds an untrained policy, as a user runs it."""

import json
import math
import subprocess
from pathlib import Path

import forked
import pytest
import torch
from configs import composed
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from dynasindy.envs import ControlEnv

REPOSITORY = Path(__file__).parents[2]
SCENARIOS = sorted(path.stem for path in (REPOSITORY / "conf" / "scenario").glob("*.yaml"))


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    config = composed("train", f"folder={folder}", "experiment=smoke", "env.substeps=1", "scenario.seconds=2")
    (folder / "config.yaml").write_text(OmegaConf.to_yaml(config, resolve=True))
    policy = instantiate(config.agent, _convert_="all")(n_obs=8, n_u=2).deployed
    torch.save(policy.state_dict(), folder / "policy.pt")
    return folder


@pytest.fixture
def saved_run(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(REPOSITORY / "scripts")
    import saved_run

    return saved_run


def evaluate(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return forked.call("evaluate", *arguments, cwd=cwd)


def test_it_writes_tables_figures_and_an_animation(run_folder: Path, tmp_path: Path) -> None:
    done = evaluate(f"run={run_folder}", "scenarios=[delay]", "animate=true", "formats=[svg]", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Scenario 'delay' (64 references, 2 s)" in done.stdout  # as long as those of the run
    names = {path.name for path in (run_folder / "evaluation").iterdir()}
    assert names == {"delay.json", "delay.csv", "delay.svg", "delay_errors.svg", "delay.gif"}
    plain = json.loads((run_folder / "evaluation" / "delay.json").read_text())
    assert plain["rows"] == 64
    done = evaluate(f"run={run_folder}", "scenarios=[delay]", "integral=true", "formats=[]", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads((run_folder / "evaluation_integral" / "delay.json").read_text()) != plain  # results of its own


@pytest.mark.slow
def test_a_policy_that_was_trained_behind_sensors_is_evaluated_behind_them(tmp_path: Path) -> None:
    words = ["system=tras", "sensors=bench", "world_model=oracle", "experiment=gradient_smoke", "train.episodes=0"]
    words += ["scenario.episodes=2", "scenario.seconds=4", "hydra.run.dir=run"]
    done = forked.call("train", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    record = json.loads((tmp_path / "run" / "observer.json").read_text())
    assert len(record["process_noise"]) == 8 and record["nis"] < 1.5
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["observer"] == record
    results = []
    for change in ("", '{"process_noise": [0.1, 0.1, 0.1, 0.1, 0.1, 0.1], "nis": 1.0}', "{}"):
        (tmp_path / "run" / "observer.json").write_text(change or json.dumps(record))
        done = evaluate("run=run", "scenarios=[detuned]", "formats=[]", cwd=tmp_path)
        results.append(done.stdout if done.returncode == 0 else done.stderr)
    assert "Scenario 'detuned'" in results[0] and results[0] != results[1]
    assert "observer.json" in results[2] and "'process_noise'" in results[2]


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_is_built_under_its_own_name(name: str, run_folder: Path, saved_run) -> None:
    config = saved_run.load_config(run_folder)
    env, _ = saved_run.load_policy(config, run_folder)
    assert saved_run.load_scenario(name, config, env).name == name


def short_of(config: DictConfig) -> tuple[DictConfig, ControlEnv]:
    """Return the configuration of a run as it is flown for as long as a scenario says, and its environment."""
    config = OmegaConf.merge(config, {"scenario": {"seconds": None}})
    system = instantiate(config.system)
    task = instantiate(config.task, _convert_="all")(signature=system.signature)
    return config, instantiate(config.env)(system=system, task=task)


def run_of(plant: str) -> tuple[DictConfig, ControlEnv]:
    return short_of(composed("train", f"system={plant}"))


@pytest.mark.parametrize("plant", ["tras", "xi"])
def test_a_twin_rotor_is_flown_in_the_waves_and_the_noise_of_the_paper(plant: str, saved_run) -> None:
    config, env = run_of(plant)
    printed = {"sine": ([0.35, 0.25], 0.015, 100.0), "square": ([0.4, -0.5], 0.01, 200.0)}
    for shape, (amplitude, frequency, seconds) in printed.items():
        scenario = saved_run.load_scenario(shape, config, env)
        rows = scenario.reference.sample(torch.Size(()), torch.Generator())
        wanted = torch.tensor([[0.0, a, frequency, 0.0, float(shape == "square")] for a in amplitude])
        assert torch.equal(rows, wanted) and scenario.length(env) == seconds
    (noise,) = saved_run.load_scenario("noise", config, env).wrappers
    assert noise(lambda td: td, env).std.tolist() == torch.tensor([0.002, 0.002, 0.02, 0.02, 40.0, 20.0]).tolist()


def test_what_a_run_says_of_a_twin_rotor_counts_as_a_whole(saved_run) -> None:
    config, env = run_of("tras")
    config.plant.noise = {"alpha_a": 0.01}
    (noise,) = saved_run.load_scenario("noise", config, env).wrappers
    assert noise(lambda td: td, env).std.tolist() == pytest.approx([0.01, 0, 0, 0, 0, 0])
    config.plant.signals = {"sine": {"amplitude": [0.1, 0.1]}}
    sine = saved_run.load_scenario("sine", config, env)
    # What is not said follows from the plant: one and a half periods, each as long as an episode.
    period = env.task.max_steps * env.dt
    rows = sine.reference.sample(torch.Size(()), torch.Generator())
    assert rows[:, 1:3].tolist() == [pytest.approx([0.1, 1 / period])] * 2
    assert sine.length(env) == pytest.approx(1.5 * period)
    config.plant.noise = None
    (noise,) = saved_run.load_scenario("noise", config, env).wrappers
    assert noise(lambda td: td, env).std[4:].tolist() == [20.0, 20.0]  # of its tachometers [rpm]


def test_scenarios_follow_a_plant_with_one_output_and_its_sensors(saved_run) -> None:
    # Targets of -1 to 1 rad, episodes of 5 s.
    config, env = short_of(composed("train", "folder=x", "system=pendulum", "env.dt=0.1", "task.max_steps=50"))
    sine, square = (saved_run.load_scenario(name, config, env) for name in ("sine", "square"))
    rows = sine.reference.sample(torch.Size(()), torch.Generator())
    torch.testing.assert_close(rows, torch.tensor([[0.0, 0.5, 0.2, 0.0, 0.0]]))
    assert (sine.length(env), square.length(env)) == (7.5, 10.0)  # one and a half periods, and two
    (noise,) = saved_run.load_scenario("noise", config, env).wrappers
    # An encoder of 4096 counts errs uniformly within a count; of the rate, whose range is 3 rad/s, nothing is said.
    assert noise(lambda td: td, env).std.tolist() == pytest.approx(
        [2 * math.pi / 4096 / math.sqrt(12), 0.003], rel=1e-5
    )


def test_unknown_scenarios_and_unfinished_runs_are_refused(run_folder: Path, tmp_path: Path, saved_run) -> None:
    config = saved_run.load_config(run_folder)
    with pytest.raises(ValueError, match=r"'stepp'.* delay, .*wind"):
        saved_run.load_scenario("stepp", config, None)
    with pytest.raises(FileNotFoundError, match=r"policy\.pt"):
        saved_run.load_policy(config, tmp_path)
    torch.save({"weight": torch.zeros(3)}, tmp_path / "policy.pt")
    with pytest.raises(ValueError, match=r"config\.yaml"):
        saved_run.load_policy(config, tmp_path)
