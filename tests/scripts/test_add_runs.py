"""Adding finished runs to the table of controllers: which rows they become, and what is refused."""

import json
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import OmegaConf

from dynasindy.evaluation.scenarios import Scenario, step_references
from dynasindy.safe_io import read_rows

CONF = Path(__file__).parents[2] / "conf"


@pytest.fixture
def add_runs(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(CONF.parent / "scripts")
    import add_runs

    short = [Scenario("step", step_references((-0.5, -0.5), (0.5, 0.4), 1), 1, 0.5)]
    monkeypatch.setattr(add_runs.baselines, "scenarios", lambda plant: short)
    return add_runs


def run(folder: Path, *overrides: str) -> Path:
    """Make the folder of a run that ended, with an untrained policy."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("train", ["experiment=smoke", "seed=3", f"folder={folder}", *overrides])
    folder.mkdir()
    (folder / "config.yaml").write_text(OmegaConf.to_yaml(config, resolve=True))
    policy = instantiate(config.agent, _convert_="all")(n_obs=8, n_u=2).deployed
    torch.save(policy.state_dict(), folder / "policy.pt")
    (folder / "metrics.json").write_text(json.dumps({"cost": {"plant_seconds": 130.0}}))
    return folder


def test_a_run_becomes_the_rows_of_its_controller_and_replaces_earlier_ones(add_runs, tmp_path):
    table = tmp_path / "baselines.csv"
    folder = run(tmp_path / "run", "system=xi", "planning=dyna", "planning.rollouts=4")
    for _ in range(2):
        add_runs.main([str(folder), "--out", str(table)])
    rows = read_rows(table)
    heads = {tuple(row[name] for name in ("plant", "controller", "model", "seed", "real_seconds")) for row in rows}
    assert heads == {("xi", "4 rollouts", "identified", "3", "130.0")}
    assert [row["metric"] for row in rows] == list(add_runs.baselines.METRICS)
    assert "| 4 rollouts | identified | 130 | 1 |" in table.with_suffix(".md").read_text()


@pytest.mark.parametrize(
    ("overrides", "name"),
    [
        (["planning=none"], ("no planning", "none")),
        (["planning=dyna", "planning.rollouts=0"], ("no planning", "none")),
        (["planning=dyna", "planning.rollouts=4", "world_model=oracle"], ("4 rollouts", "true")),
        (["planning=gradient"], ("planning by gradient", "identified")),
    ],
)
def test_a_run_is_named_by_its_planning_and_its_model(add_runs, overrides, name):
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("train", ["system=tras", "folder=none", *overrides])
    assert add_runs.controller(config) == name


def test_runs_that_would_replace_each_other_are_refused(add_runs, tmp_path):
    folders = [run(tmp_path / str(n), "planning=dyna", "planning.rollouts=4") for n in (4, 8)]
    with pytest.raises(ValueError, match=r"4 and .*8 "):
        add_runs.keys(folders)
