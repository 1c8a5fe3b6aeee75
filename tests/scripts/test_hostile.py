"""Files of strangers: whatever they hold, no code of theirs runs, nothing outside is touched, and one line says why."""

import importlib
import json
import math
import os
import pickle
import re
import shutil
import sys
import zipfile
from pathlib import Path

import forked
import joblib
import pytest
import torch
import yaml
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import OmegaConf

REPOSITORY = Path(__file__).parents[2]
ROOMS = ("system", "task", "env", "agent")


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
    with initialize_config_dir(str(REPOSITORY / "conf"), version_base="1.3"):
        config = compose("train", [f"folder={folder}", "experiment=smoke", "env.substeps=1", "agent.hidden=[4]"])
    (folder / "config.yaml").write_text(OmegaConf.to_yaml(config, resolve=True))
    policy = instantiate(config.agent, _convert_="all")(n_obs=8, n_u=2).deployed
    torch.save(policy.state_dict(), folder / "policy.pt")
    (folder / "metrics.json").write_text(json.dumps({"cost": {"plant_seconds": 30.0}}))
    (folder / "origin.json").write_text(json.dumps({"command": "python scripts/train.py", "commit": "abc1234"}))
    return folder


@pytest.fixture
def run(good: Path, tmp_path: Path) -> Path:
    return shutil.copytree(good, tmp_path / "stranger" / "run")


@pytest.fixture
def canary(tmp_path: Path) -> Path:
    return tmp_path / "canary"


@pytest.fixture
def saved_run(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(REPOSITORY / "scripts")
    import saved_run

    return saved_run


def change(run: Path, where: str, value: object) -> None:
    """Put something into a run's config.yaml, at a dotted key."""
    config = yaml.safe_load((run / "config.yaml").read_text())
    node, (*path, last) = config, where.split(".")
    for step in path:
        node = node.setdefault(step, {})
    node[last] = value
    (run / "config.yaml").write_text(yaml.safe_dump(config))


def refused(saved_run, run: Path, *said: str, plugins=()) -> str:
    """Load a run as evaluate.py does; return the one line that refuses it."""
    with pytest.raises(ValueError, match="|".join(said)) as error:
        saved_run.load_policy(saved_run.load_config(run, *([plugins] if plugins else [])), run)
    assert "\n" not in str(error.value)
    return str(error.value)


def targets(canary: Path) -> dict[str, dict[str, object]]:
    """Return what ran code of a config.yaml's author, and more of its kind."""
    touch = f"__import__('pathlib').Path({str(canary)!r}).touch()"
    pickled = canary.with_name("pickled")
    return {
        "os.system": {"command": f"touch {canary}"},
        "builtins.eval": {"_args_": [touch]},
        "builtins.open": {"file": str(canary), "mode": "w"},
        "subprocess.run": {"args": ["touch", str(canary)]},
        "sympy.sympify": {"a": touch},
        "joblib.load": {"filename": str(pickled)},
        "torch.load": {"f": str(pickled), "weights_only": False},
        "numpy.load": {"file": str(pickled), "allow_pickle": True},
        "hydra.utils.call": {"config": {"x": 1}},
        "hydra.utils.get_object": {"path": "os.system"},
        "hydra.utils.get_method": {"path": "os.system"},
        "hydra.utils.get_class": {"path": "pathlib.Path"},
        "dynasindy.evaluation.saved.shutil.copy": {"src": str(REPOSITORY / "README.md"), "dst": str(canary)},
        "dynasindy.evaluation.saved.os.system": {"command": f"touch {canary}"},
        "dynasindy.dyna.weights.torch.load": {"f": str(pickled), "weights_only": False},
        "dynasindy.safe_io.Path": {"_args_": [str(canary)]},
        "dynasindy.safe_io.write_rows": {"path": str(canary), "columns": ["a"], "rows": []},
        "dynasindy.safe_io.write_csv": {"path": str(canary), "header": ["a"], "rows": []},
        "dynasindy.sindy.SindyModel.load": {"path": str(pickled)},
        "dynasindy.sindy.register_function": {"name": "sin", "compute": None},
        "dynasindy.data.csv.CsvLog": {"path": "/etc/passwd", "states": {"a": "a"}, "inputs": {"u": "u"}},
        "dynasindy.systems.Tras.__class__": {},
        "dynasindy": {},
        "stranger_part.Part": {"canary": str(canary)},
    }


NAMES = list(targets(Path("/x")))


@pytest.mark.parametrize("where", ["system", "plant.low", "unused.deep.down"])
@pytest.mark.parametrize("target", NAMES)
def test_a_target_that_is_no_part_is_neither_built_nor_looked_up(saved_run, run, canary, target, where):
    joblib.dump(Touch(canary), canary.with_name("pickled"))
    change(run, where, {"_target_": target, **targets(canary)[target]})
    refused(saved_run, run, r"config\.yaml has _(target|args)_")
    assert not canary.exists()


@pytest.mark.parametrize(
    "node",
    [
        {"_target_": ["os", "system"]},
        {"_target_": {"_target_": "os.system"}},
        {"_target_": "dynasindy.systems.Tras", "_args_": [1]},
        {"_target_": "dynasindy.systems.Tras", "_partial_": "yes"},
        {"_target_": "dynasindy.systems.Tras", "_recursive_": False},
        {"_target_": "dynasindy..systems.Tras"},
        {"_target_": "dynasindy.systems.Tras\nos.system"},
        {"_target_": " os.system"},
        {"_target_": "dynasindy.systems.nothing"},
        {"_target_": "hydra.utils.get_object", "path": "torch.load"},
        {"_target_": "hydra.utils.get_object", "path": "torch.float64.__class__"},
        {"_target_": "hydra.utils.get_object", "path": "torch.hub.load"},
    ],
)
def test_words_of_hydra_that_no_run_writes_are_refused(saved_run, run, node):
    change(run, "system", node)
    refused(saved_run, run, r"config\.yaml has _")


def test_a_list_is_searched_too(saved_run, run, canary):
    change(run, "plant.outputs", [[{"_target_": "os.system", "command": f"touch {canary}"}]])
    refused(saved_run, run, "os.system")
    assert not canary.exists()


def test_an_environment_of_another_module_is_imported_only_where_the_user_names_it(saved_run, run, canary, tmp_path):
    node = {"_target_": "dynasindy.envs.Foreign", "id": "my_environments:Swing-v0"}
    change(run, "system", node)
    refused(saved_run, run, r"imports 'my_environments'; name it if you trust it")
    saved_run.load_config(run, ["my_environments"])
    for options in ({"xml_file": "/etc/passwd"}, {"size": [1]}, ["a"]):
        change(run, "system", {**node, "id": "Pendulum-v1", "options": options})
        refused(saved_run, run, r"system\.options with .*allowed are numbers")
    change(run, "system", {**node, "id": "Pendulum-v1", "options": {"g": 9.0}})
    saved_run.load_config(run)


PART = """
import pathlib
from dynasindy.systems import Tras
pathlib.Path({canary!r}).touch()
class Part(Tras):
    pass
from os import system
"""


def test_a_plug_in_is_imported_only_where_the_user_names_it(saved_run, run, canary, tmp_path, monkeypatch):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "my_part.py").write_text(PART.format(canary=str(canary)))
    monkeypatch.syspath_prepend(tmp_path / "site")
    change(run, "system", {"_target_": "my_part.Part"})
    assert "of another package; allowed are parts of dynasindy" in refused(saved_run, run, "my_part")
    refused(saved_run, run, "of another package", plugins=["my"])
    assert not canary.exists() and "my_part" not in sys.modules
    env, _ = saved_run.load_policy(saved_run.load_config(run, ["my_part"]), run)
    assert type(env.system).__name__ == "Part" and canary.exists()
    for several in ("other my_part", "other,my_part", "my_part, other"):
        monkeypatch.setenv("DYNASINDY_PLUGINS", several)
        assert type(saved_run.load_policy(saved_run.load_config(run), run)[0].system).__name__ == "Part"
    monkeypatch.setenv("DYNASINDY_PLUGINS", "other:my_part")
    refused(saved_run, run, "DYNASINDY_PLUGINS=PACKAGE,OTHER; named are other:my_part")
    monkeypatch.setenv("DYNASINDY_PLUGINS", "my_part")
    change(run, "system", {"_target_": "my_part.system", "command": f"touch {tmp_path / 'second'}"})
    refused(saved_run, run, "no part of an experiment", plugins=["my_part"])
    assert not (tmp_path / "second").exists()
    monkeypatch.delitem(sys.modules, "my_part")


def test_a_plug_in_that_is_not_found_costs_one_line_that_says_how_to_find_it(
    saved_run, run, caplog, tmp_path, monkeypatch
):
    change(run, "system", {"_target_": "my_plants.Tank"})
    told = refused(saved_run, run, "No module named 'my_plants'", plugins=["my_plants"])
    assert "name the folder that my_plants lies in by PYTHONPATH" in told and not caplog.records
    (tmp_path / "my_plants.py").write_text("raise OSError('no licence\\nfor it')")
    monkeypatch.syspath_prepend(tmp_path)
    told = refused(saved_run, run, r"cannot be imported \(OSError: no licence for it\)", plugins=["my_plants"])
    assert "PYTHONPATH" not in told  # it is found


def test_no_admitted_class_takes_a_file(monkeypatch):
    monkeypatch.syspath_prepend(REPOSITORY / "scripts")
    import inspect
    import pkgutil

    import admitted

    import dynasindy

    seen = 0
    for found in pkgutil.walk_packages(dynasindy.__path__, "dynasindy."):
        for part in vars(importlib.import_module(found.name)).values():
            if inspect.isclass(part) and part.__module__ == found.name and admitted._is_part(part, "dynasindy"):
                seen += 1
                given = set(inspect.signature(part.__init__).parameters)
                assert not given & {"path", "file", "folder", "root", "command", "filename"}, part
    assert seen > 50


def test_every_part_of_the_groups_and_every_saved_run_is_admitted(saved_run):
    from admitted import check

    for folder in sorted((REPOSITORY / "docs" / "results" / "runs").iterdir()):
        assert saved_run.load_config(folder).seed == 0
    groups = ("system", "task", "excitation", "world_model", "agent", "planning", "scenario")
    for group in groups:
        for file in (REPOSITORY / "conf" / group).glob("[a-z]*.yaml"):
            if file.stem in ("logged", "unknown"):
                continue
            with initialize_config_dir(str(REPOSITORY / "conf"), version_base="1.3"):
                config = compose("train", [f"{group}={file.stem}", "folder=x"])
            check(OmegaConf.to_container(config, resolve=True))


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{b}: &{b} [{','.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi")
)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BOMB, "anchors and aliases"),
        ("x: " + "[" * 100_000, "nested more than 20 deep|YAML"),
        ("x: " + "a" * 1_000_000, "bytes; at most"),
        ("x: !!python/object/apply:os.system ['touch {canary}']\n", "the tag tag:yaml"),
        ("x: !!python/object/apply:pathlib.Path ['x']\n", "the tag tag:yaml"),
        ("system: ${oc.env:HOME}\n", "the interpolation"),
        ('system: "\\x24{oc.env:HOME}"\n', "the interpolation"),
        ("${oc.env:HOME}: 1\n", "the interpolation"),
        ("plant: ${hydra:runtime.cwd}\n", "the interpolation"),
        ("a: 1\na: 2\n", "duplicate"),
        ("a: [1\n", "config.yaml"),
        ("- 1\n", "keys and values"),
        ("a: 1\n", "has no system"),
        ("", "has no system"),
        (b"\xff\xfe\x00", "no UTF-8 text|config.yaml"),
        (b"\x00\x01", "config.yaml"),
    ],
)
def test_a_config_that_is_no_plain_yaml_is_refused(saved_run, run, canary, text, said):
    raw = text if isinstance(text, bytes) else text.replace("{canary}", str(canary)).encode()
    (run / "config.yaml").write_bytes(raw)
    assert "config.yaml" in refused(saved_run, run, said)
    assert not canary.exists()


@pytest.mark.parametrize("part", ROOMS)
@pytest.mark.parametrize("other", ["dynasindy.planning.Gate", "dynasindy.agents.networks.MLP", "dynasindy.tasks.Step"])
def test_a_part_in_the_wrong_place_costs_a_line(saved_run, run, part, other):
    change(run, part, {"_target_": other, "_partial_": part != "system"})
    from mistakes import MENDABLE, in_words

    with pytest.raises(MENDABLE) as error:
        saved_run.load_policy(saved_run.load_config(run), run)
    assert in_words(error.value, "evaluate")


def test_a_network_larger_than_memory_is_not_built(saved_run, run):
    change(run, "agent.hidden", [10**6, 10**6])
    from mistakes import MENDABLE, in_words

    with pytest.raises(MENDABLE) as error:
        saved_run.load_policy(saved_run.load_config(run), run)
    assert "what the memory of this computer holds" in in_words(error.value, "evaluate")


def hostile_weights(kind: str, file: Path, canary: Path) -> None:
    weights = torch.load(file, weights_only=True)
    name = next(iter(weights))
    if kind == "pickle":
        file.write_bytes(pickle.dumps(Touch(canary)))
    elif kind == "pickle in torch":
        torch.save({**weights, name: Touch(canary)}, file)
    elif kind == "old format":
        torch.save({name: Touch(canary)}, file, _use_new_zipfile_serialization=False)
    elif kind == "bomb":
        with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("archive/data/99", bytes(50_000_000))
    elif kind == "stretched":
        torch.save({**weights, name: torch.zeros(1).expand(10**6, 10**6)}, file)
    elif kind == "sparse":
        torch.save({**weights, name: weights[name].to_sparse()}, file)
    elif kind == "no tensors":
        torch.save({name: 1, 2: "x"}, file)
    elif kind == "a list":
        torch.save([1, 2], file)
    elif kind == "not finite":
        torch.save({**weights, name: weights[name] * math.nan}, file)
    elif kind == "cut":
        file.write_bytes(file.read_bytes()[:1000])


KINDS = ("pickle", "pickle in torch", "old format", "bomb", "stretched", "sparse", "no tensors", "a list", "not finite")


@pytest.mark.parametrize("kind", [*KINDS, "cut"])
def test_weights_are_weights(saved_run, run, canary, kind):
    hostile_weights(kind, run / "policy.pt", canary)
    refused(saved_run, run, r"holds no weights", "unpacks to 500", "does not fit", "not finite")
    assert not canary.exists()


def linked(run: Path, name: str, to: Path) -> None:
    (run / name).parent.mkdir(exist_ok=True)
    (run / name).symlink_to(to)


@pytest.mark.parametrize("name", ["evaluation", "evaluation/step.json", "evaluation/step.csv"])
def test_results_are_not_written_through_links(run, tmp_path, name):
    from dynasindy.safe_io import output_folder

    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "notes.txt").write_text("untouched")
    linked(run, name, mine if name == "evaluation" else mine / "notes.txt")
    with pytest.raises(ValueError, match="is a link, and may lead anywhere"):
        output_folder(run, "evaluation")


def script(name: str, *arguments: str, cwd: Path) -> str:
    """Run a script that must refuse what it is given; return its one line."""
    command = [sys.executable, str(REPOSITORY / "scripts" / f"{name}.py"), *arguments]
    done = forked.run(command, cwd=cwd, timeout=300)
    lines = done.stderr.strip().splitlines()
    assert done.returncode == 2 and len(lines) == 1 and lines[0].startswith("error: "), done.stderr
    return lines[0]


def test_evaluate_refuses_in_one_line(run, canary, tmp_path):
    change(run, "system", {"_target_": "os.system", "command": f"touch {canary}"})
    assert "of another package" in script("evaluate", f"run={run}", cwd=tmp_path)
    assert not canary.exists()


@pytest.mark.parametrize("name", ["add_runs", "report"])
def test_the_other_scripts_read_a_run_by_the_same_rule(saved_run, run, canary, tmp_path, name):
    change(run, "system", {"_target_": "os.system", "command": f"touch {canary}"})
    module = importlib.import_module(name)
    with pytest.raises(ValueError, match="of another package"):
        module.main([str(run), "--out", str(tmp_path / "b.csv")]) if name == "add_runs" else module.measure(run, [], [])
    assert not canary.exists() and not (tmp_path / "b.csv").exists()


def test_evaluate_leaves_what_a_link_leads_to(run, tmp_path):
    mine = tmp_path / "mine.txt"
    mine.write_text("untouched")
    linked(run, "evaluation/step.json", mine)
    assert "is a link" in script("evaluate", f"run={run}", "scenarios=[step]", cwd=tmp_path)
    assert mine.read_text() == "untouched"


@pytest.mark.parametrize("name", ["../../x", "/etc/passwd", "step.yaml", "..", ""])
def test_a_scenario_is_a_name_in_conf(saved_run, run, name):
    with pytest.raises(ValueError, match="is unknown; use some of"):
        saved_run.load_scenario(name, saved_run.load_config(run), None)


GARBAGE = {
    "empty": b"",
    "cut": b'{"cost": {"plant_',
    "a list": b"[1, 2]",
    "a number": b"7",
    "no keys": b"{}",
    "wrong types": b'{"cost": [1], "untrained": 3, "evaluation": "x", "seed": {}}',
    "deep": b"[" * 200_000,
    "no text": b"\xff\xfe\x00{}",
    "zeros": bytes(64),
    "many digits": b'{"cost": {"plant_seconds": ' + b"9" * 5000 + b"}}",
}


def garble(file: Path, kind: str) -> None:
    """Put garbage where a file was."""
    file.unlink(missing_ok=True)
    if kind == "a folder":
        file.mkdir()
    elif kind == "a loop":
        file.symlink_to(file.name)
    elif kind == "a pipe":
        os.mkfifo(file)
    else:
        file.write_bytes(GARBAGE[kind])


@pytest.mark.parametrize("kind", [*GARBAGE, "a folder", "a pipe"])
def test_add_runs_says_in_a_line_that_metrics_are_damaged(saved_run, run, tmp_path, kind, monkeypatch):
    import add_runs

    monkeypatch.setattr(add_runs.baselines, "judge", lambda *_: pytest.fail("went on"))
    garble(run / "metrics.json", kind)
    with pytest.raises(ValueError, match=r"metrics\.json (is damaged|is no file)") as error:
        add_runs.main([str(run), "--out", str(tmp_path / "b.csv")])
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("kind", [*GARBAGE, "a folder", "a pipe"])
def test_table_says_in_a_line_that_metrics_are_damaged(run, kind):
    from dynasindy.evaluation.statistics import sweep_table

    garble(run / "metrics.json", kind)
    with pytest.raises((ValueError, FileNotFoundError)) as error:
        sweep_table(run.parent)
    assert re.search(r"metrics\.json (is damaged|is no file)", str(error.value)) and "\n" not in str(error.value)


def test_table_ends_with_one_line(run, tmp_path):
    garble(run / "metrics.json", "cut")
    assert "metrics.json is damaged" in script("table", str(run.parent), cwd=tmp_path)
    assert "give one folder" in script("table", cwd=tmp_path)


def test_a_config_in_a_loop_of_links_is_none(saved_run, run):
    garble(run / "config.yaml", "a loop")
    with pytest.raises(FileNotFoundError, match=r"has no config\.yaml"):
        saved_run.load_config(run)
