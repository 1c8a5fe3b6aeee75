"""Folders of others: whatever they hold, no code of theirs runs, nothing outside is touched, and one line says why."""

import json
import math
import os
import pickle
import shutil
import sys
import zipfile
from pathlib import Path

import joblib
import pytest
import torch
import yaml
from configs import composed
from hydra.utils import instantiate
from omegaconf import OmegaConf

REPOSITORY = Path(__file__).parents[2]
sys.path.append(str(REPOSITORY / "scripts"))
from command import one_line  # noqa: E402
from saved_run import load_config, load_policy  # noqa: E402


class Touch:
    """Make a file when unpickled."""

    def __init__(self, canary: Path) -> None:
        self.canary = canary

    def __reduce__(self):
        return (Path.touch, (self.canary,))


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("good") / "run"
    folder.mkdir()
    words = [f"folder={folder}", "experiment=smoke", "env.substeps=1", "agent.hidden=[4]", "scenario.seconds=2"]
    config = composed("train", *words)
    (folder / "config.yaml").write_text(OmegaConf.to_yaml(config, resolve=True))
    policy = instantiate(config.agent, _convert_="all")(n_obs=8, n_u=2).deployed
    torch.save(policy.state_dict(), folder / "policy.pt")
    (folder / "metrics.json").write_text(json.dumps({"cost": {"plant_seconds": 30.0}}))
    (folder / "origin.json").write_text(json.dumps({"command": "python scripts/train.py", "commit": "abc1234"}))
    return folder


@pytest.fixture
def run(good: Path, tmp_path: Path) -> Path:
    return shutil.copytree(good, tmp_path / "others" / "run")


@pytest.fixture
def canary(tmp_path: Path) -> Path:
    return tmp_path / "canary"


@pytest.fixture
def evaluated(run, refused):
    """Return the one line by which the command refuses the folder, in which it leaves nothing."""
    return lambda *words: refused("evaluate", f"run={run}", "scenarios=[step]", *words, cwd=run.parents[1])


@pytest.fixture
def read(run, capsys):
    """Return the one line by which every command refuses the folder as it reads it, here without its process."""

    def line():
        with pytest.raises(SystemExit) as ended, one_line():
            load_policy(load_config(run), run)
        said = capsys.readouterr().err
        assert ended.value.code == 2 and said.startswith("error: ") and said.count("\n") == 1
        return said

    return line


def change(run: Path, where: str, value: object) -> None:
    """Put something into a run's config.yaml, at a dotted key."""
    config = yaml.safe_load((run / "config.yaml").read_text())
    node, (*path, last) = config, where.split(".")
    for step in path:
        node = node.setdefault(step, {})
    node[last] = value
    (run / "config.yaml").write_text(yaml.safe_dump(config))


def test_the_folder_is_good_before_it_is_changed(run, command, tmp_path):
    done = command("evaluate", f"run={run}", "scenarios=[step]", "formats=[svg]", cwd=tmp_path)
    assert done.code == 0, done
    assert json.loads((run / "evaluation" / "step.json").read_text())["rows"] == 64


def targets(canary: Path) -> dict[str, dict[str, object]]:
    """Return what ran code of a config.yaml's author, and more of its kind."""
    touch = f"__import__('pathlib').Path({str(canary)!r}).touch()"
    pickled = canary.with_name("pickled")
    return {
        "os.system": {"command": f"touch {canary}"},
        "builtins.eval": {"_args_": [touch]},
        "joblib.load": {"filename": str(pickled)},
        "hydra.utils.call": {"config": {"x": 1}},
        "dynasindy.safe_io.os.system": {"command": f"touch {canary}"},
        "dynasindy.dyna.run.torch.load": {"f": str(pickled), "weights_only": False},
        "dynasindy.safe_io.write_csv": {"path": str(canary), "header": ["a"], "rows": []},
        "dynasindy.sindy.SindyModel.load": {"path": str(pickled)},
        "dynasindy.sindy.register_function": {"name": "sin", "formula": "{0}"},
        "dynasindy.data.recording.LogReader": {"path": "/etc/passwd", "states": {"a": "a"}, "inputs": {"u": "u"}},
        "dynasindy.systems.Tras.__class__": {},
        "dynasindy": {},
        "others_part.Part": {"canary": str(canary)},
    }


PLACES = ["system", "plant.low", "unused.deep.down"]


@pytest.mark.parametrize(("target", "where"), [(name, PLACES[k % 3]) for k, name in enumerate(targets(Path("/x")))])
def test_a_target_that_is_no_part_is_neither_built_nor_looked_up(read, run, canary, target, where):
    joblib.dump(Touch(canary), canary.with_name("pickled"))
    change(run, where, {"_target_": target, **targets(canary)[target]})
    assert "config.yaml" in read() and not canary.exists()


@pytest.mark.parametrize(
    "node",
    [
        {"_target_": {"_target_": "os.system"}},
        {"_target_": "dynasindy.systems.Tras", "_args_": [1]},
        {"_target_": "dynasindy.systems.Tras", "_partial_": "yes"},
        {"_target_": "dynasindy.systems.Tras\nos.system"},
        {"_target_": "dynasindy.systems.nothing"},
        {"_target_": "hydra.utils.get_object", "path": "torch.hub.load"},
    ],
)
def test_words_of_hydra_that_no_run_writes_are_refused(read, run, node):
    change(run, "system", node)
    assert "config.yaml" in read()


def test_a_run_that_goes_on_is_read_by_the_same_rule(run, canary, command, tmp_path):
    change(run, "plant.outputs", [[{"_target_": "os.system", "command": f"touch {canary}"}]])
    done = command("train", f"resume={run}", cwd=tmp_path)
    assert done.code == 2 and "os.system" in done.err and "Traceback" not in done.err
    assert not canary.exists() and not list(run.glob("evaluation*"))


def test_the_report_builds_nothing_of_a_run(run, canary, command, tmp_path):
    change(run, "plant.outputs", [[{"_target_": "os.system", "command": f"touch {canary}"}]])
    shutil.copytree(run, run.parent / "runs" / "run")
    done = command("report", f"results={run.parent}", cwd=tmp_path)
    assert done.code in (0, 2) and "Traceback" not in done.err and not canary.exists()


def test_an_environment_of_another_module_is_imported_only_where_the_user_names_it(evaluated, run, canary):
    node = {"_target_": "dynasindy.envs.Foreign", "id": "my_environments:Swing-v0"}
    change(run, "system", node)
    assert "my_environments" in evaluated()
    for options in ({"xml_file": "/etc/passwd"}, {"size": [1]}, ["a"]):
        change(run, "system", {**node, "id": "Pendulum-v1", "options": options})
        assert "system.options" in evaluated()


PART = """
import pathlib
from dynasindy.systems import Tras
pathlib.Path({canary!r}).touch()
class Part(Tras):
    pass
from os import system
"""


def test_a_plug_in_is_imported_only_where_the_user_names_it(evaluated, command, run, canary, tmp_path, monkeypatch):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "my_part.py").write_text(PART.format(canary=str(canary)))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"), os.pathsep)
    change(run, "system", {"_target_": "my_part.Part"})
    assert "my_part" in evaluated()
    monkeypatch.setenv("DYNASINDY_PLUGINS", "my")
    assert "my_part" in evaluated()
    monkeypatch.setenv("DYNASINDY_PLUGINS", "other:my_part")
    assert "DYNASINDY_PLUGINS" in evaluated() and not canary.exists()
    monkeypatch.setenv("DYNASINDY_PLUGINS", "other,my_part")
    change(run, "system", {"_target_": "my_part.system", "command": f"touch {tmp_path / 'second'}"})
    done = command("evaluate", f"run={run}", "scenarios=[step]", cwd=tmp_path)
    assert done.code == 2 and "my_part" in done.err and not (tmp_path / "second").exists()
    change(run, "system", {"_target_": "my_part.Part"})
    for words in (("formats=[svg]",), ("formats=[svg]", "plugins=[my_part]")):
        canary.unlink(missing_ok=True)
        done = command("evaluate", f"run={run}", "scenarios=[step]", *words, cwd=tmp_path)
        assert done.code == 0 and canary.exists(), done
        monkeypatch.delenv("DYNASINDY_PLUGINS", raising=False)


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{b}: &{b} [{','.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi")
)
ADDED = [
    BOMB,
    "x: " + "a" * 1_000_000,
    "x: !!python/object/apply:os.system ['touch {canary}']\n",
    "x: ${oc.env:HOME}\n",
    'x: "\\x24{oc.env:HOME}"\n',
    "${oc.env:HOME}: 1\n",
    "x: ${hydra:runtime.cwd}\n",
    "seed: 1\n",  # a second one
    "x: [1\n",
    b"x: \xff\xfe\n",
]
"""What a config that is good without it may not hold."""
INSTEAD = ["x: " + "[" * 100_000, "- 1\n", "a: 1\n", "", b"\xff\xfe\x00"]


@pytest.mark.parametrize(("text", "added"), [*((text, True) for text in ADDED), *((text, False) for text in INSTEAD)])
def test_a_config_that_is_no_plain_yaml_is_refused(read, run, canary, text, added):
    raw = text if isinstance(text, bytes) else text.replace("{canary}", str(canary)).encode()
    file = run / "config.yaml"
    file.write_bytes((file.read_bytes() if added else b"") + raw)
    assert "config.yaml" in read() and not canary.exists()


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("system", {"_target_": "dynasindy.planning.Gate"}),
        ("task", {"_target_": "dynasindy.planning.Gate", "_partial_": True}),
        ("env", {"_target_": "dynasindy.envs.Step", "_partial_": True}),
        ("agent", {"_target_": "dynasindy.envs.Step", "_partial_": True}),
        ("agent.hidden", [10**6, 10**6]),  # more than memory holds
    ],
)
def test_a_part_in_the_wrong_place_and_a_network_beyond_memory_cost_a_line(evaluated, run, part, value):
    change(run, part, value)
    assert evaluated()


def hostile_weights(kind: str, file: Path, canary: Path) -> None:
    weights = torch.load(file, weights_only=True)
    name = next(iter(weights))
    if kind == "pickle":
        file.write_bytes(pickle.dumps(Touch(canary)))
    elif kind == "pickle in torch":
        torch.save({**weights, name: Touch(canary)}, file)
    elif kind == "bomb":
        with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("archive/data/99", bytes(50_000_000))
    elif kind == "stretched":
        torch.save({**weights, name: torch.zeros(1).expand(10**6, 10**6)}, file)
    elif kind == "a list":
        torch.save([1, 2], file)
    elif kind == "not finite":
        torch.save({**weights, name: weights[name] * math.nan}, file)


@pytest.mark.parametrize("kind", ["pickle", "pickle in torch", "bomb", "stretched", "a list", "not finite"])
def test_weights_are_weights(read, run, canary, kind):
    hostile_weights(kind, run / "policy.pt", canary)
    assert "policy.pt" in read() and not canary.exists()


@pytest.mark.parametrize("name", ["../../x", "/etc/passwd"])
def test_a_scenario_is_a_name_in_conf(run, refused, tmp_path, name):
    assert f"'{name}'" in refused("evaluate", f"run={run}", f"scenarios=['{name}']", cwd=tmp_path)


WRONG_TYPES = b'{"cost": [1], "untrained": 3, "evaluation": "x", "seed": {}}'


@pytest.mark.parametrize("content", [b"{}", WRONG_TYPES, b"[" * 200_000, None], ids=["none", "types", "deep", "a pipe"])
def test_metrics_that_are_damaged_are_named(run, refused, tmp_path, content):
    (run / "metrics.json").unlink()
    if content is None:
        os.mkfifo(run / "metrics.json")
    else:
        (run / "metrics.json").write_bytes(content)
    assert "metrics.json" in refused("table", str(run.parent), cwd=tmp_path)
