"""A value that a key does not take costs one line that names the key, what was given and what is allowed."""

import copy
import errno
import math
import re
import shlex
import socket
import sys
from functools import cache
from pathlib import Path

import forked
import pytest
from hydra import compose, initialize_config_dir
from hydra.errors import ConfigCompositionException
from omegaconf import OmegaConf

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
sys.path.append(str(SCRIPTS))
from cli import CONF  # noqa: E402
from errors import in_words  # noqa: E402
from settings import check  # noqa: E402

ALL = ("train", "ablation", "identify", "evaluate", "report", "export", "check")


@cache
def composed(command, *overrides):
    with initialize_config_dir(str(SCRIPTS.parent / "conf"), version_base="1.3"):
        cfg = compose(command, list(overrides))
    if "folder" in cfg:
        cfg.folder = "run"
    return cfg


@pytest.mark.parametrize("command", ALL)
def test_what_conf_holds_is_allowed_and_stays_as_it_is(command):
    cfg = composed(command)
    before = OmegaConf.to_yaml(cfg)
    check(cfg)
    assert OmegaConf.to_yaml(cfg) == before


@pytest.mark.parametrize(
    ("key", "given"),
    [
        ("seed", "x"),
        ("seed", 2**63),
        ("seed", True),
        ("seed", "9" * 400),
        ("env.dtype", 2.5),
        ("threads", 1_000_000),
        ("train.updates_per_step", math.inf),
        ("train.episodes", 2.5),
        ("train.episodes", 10**12),
        ("excitation.duration", math.nan),
        ("excitation.band", [0.0, "x"]),
        ("env.dt", None),
        ("env.dt", "SECONDS"),
        ("train.held_out", "NUMBER"),
        ("agent.hidden", 400),
        ("agent.machine_code", 1),
        ("agent.tua", 1),
        ("gate.open_below", None),
        ("excitation._target_", "dynasindy.systems.Tras"),
        ("gate", None),
        ("task.reward._target_", "dynasindy.tasks.Step"),
        ("system._target_", "no.such"),
        ("plant.low", ["a", "b"]),
        ("task.outputs", "alpha_a"),
        ("world_model.refinement.method", "best"),
        ("world_model.refinement", {"method": "auto"}),
        ("env.dt", 1e9),
        ("env.dtype", "float16"),
    ],
)  # fmt: skip
def test_a_bad_value_is_named(key, given):
    cfg = copy.deepcopy(composed("train", "experiment=smoke", "planning=dyna"))
    OmegaConf.update(cfg, key, given, merge=False, force_add=True)
    with pytest.raises(ValueError, match=key.removesuffix("._target_").rpartition(".")[2]) as error:
        check(cfg)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("key", "given", "taken"),
    [
        ("agent.tau", "1e-3", 1e-3),
        ("train.episodes", 10.0, 10),
        ("gate.state_error", ".inf", math.inf),
        ("gate.close_above", "inf", math.inf),
        ("agent.hidden", ["64", 32.0], [64, 32]),
        ("folder", 2026, "2026"),
    ],
)
def test_text_that_is_a_number_becomes_one(key, given, taken):
    cfg = copy.deepcopy(composed("train"))
    OmegaConf.update(cfg, key, given, merge=False)
    check(cfg)
    found = OmegaConf.select(cfg, key)
    assert repr(found) == repr(taken)


@pytest.mark.parametrize(
    ("command", "words", "allowed"),
    [
        ("export", "formats=[png]", ("c", "onnx", "fmu", "model")),
        ("export", "fmi=1", ("2", "3")),
        ("check", "grid=1", ("2", "100")),
        ("check", "low=[x]", ()),
        ("evaluate", "formats=[onnx]", ("png", "svg")),
    ],
)
def test_formats_are_those_of_the_command(command, words, allowed):
    with pytest.raises(ValueError, match=words.partition("=")[0]) as error:
        check(composed(command, words))
    assert all(each in str(error.value) for each in allowed)


@pytest.mark.parametrize(
    ("word", "hint"),
    [
        ("planning.lrr", "'lr'"),
        ("episodes", "'train.episodes' or 'scenario.episodes'"),
        ("planning.seed", "'seed'"),
        ("duration", "'excitation.duration'"),  # and not evaluation, which is spelt alike
    ],
)
def test_a_key_that_is_misspelt_or_stands_elsewhere_is_offered(monkeypatch, word, hint):
    monkeypatch.setattr(sys, "argv", ["train.py", f"{word}=1"])
    with initialize_config_dir(str(CONF), version_base="1.3"), pytest.raises(ConfigCompositionException) as error:
        compose("train", [f"{word}=1"])
    line = in_words(error.value, "train")
    assert line.endswith(f"; did you mean {hint}?") and "; allowed are " in line


def test_a_key_that_means_nothing_that_exists_comes_with_those_of_its_group(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["train.py", "checkpoint.xyz=1"])
    with initialize_config_dir(str(CONF), version_base="1.3"), pytest.raises(ConfigCompositionException) as error:
        compose("train", ["checkpoint.xyz=1"])
    line = in_words(error.value, "train")
    assert "'xyz'" in line and line.endswith("every")


def test_a_plant_in_the_place_of_what_is_known_of_one_is_named():
    with pytest.raises(ValueError, match=r"^plant is 'tras'"):
        check(OmegaConf.create({"plant": "tras"}))


@pytest.mark.parametrize(
    ("word", "meant"),
    [("+plant.strat={theta: 1}", "'start'"), ("+plant.signals.stepp=[[0.1]]", "'step'"), ("+plant.mass=2", "'mass'")],
)
def test_a_setting_of_a_plant_that_nothing_reads_is_refused(word, meant):
    cfg = composed("train", "system=pendulum", word)
    with pytest.raises(ValueError, match=meant):
        check(cfg)
    check(cfg, "run/config.yaml")  # what another version wrote is looked at by what it builds


@pytest.mark.parametrize("key", ["plant.mass", "plant.signals.ramp"])
def test_a_plant_may_read_settings_of_its_own(key):
    check(composed("train", "system=pendulum", f"+{key}=2", f"+system.mass=${{{key}}}"))


def test_what_is_not_given_is_missed():
    cfg = composed("train", "~replay.capacity")
    with pytest.raises(ValueError, match=r"replay\.capacity"):
        check(cfg)


def test_the_file_of_a_config_is_named():
    with pytest.raises(ValueError, match=r"config\.yaml: seed"):
        check(composed("train", "seed=-1"), "run/config.yaml")
    with pytest.raises(ValueError, match=r"config\.yaml: 'gate'"):
        check(composed("train", "~gate"), "run/config.yaml")


def test_identify_takes_world_models_without_a_refinement():
    check(composed("identify", "world_model=sindy_paper"))
    assert composed("identify").world_model.refinement.method == "auto"
    assert composed("train").world_model.refinement.method == "integral"


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda folder: (folder / "none" / "file").write_text(""), "none/file"),
        (lambda folder: folder.write_text(""), "directory"),
        (lambda folder: (folder / ("x" * 300)).write_text(""), "too long"),
        (lambda folder: Path("/dev/full").write_text("x"), "space"),
        (lambda folder: Path("/proc/x/y").mkdir(parents=True), "/proc/x"),
    ],
)
def test_what_the_system_refuses_costs_one_line(tmp_path, make, words):
    with pytest.raises(OSError, match=r".") as error:
        make(tmp_path)
    line = in_words(error.value, "train")
    assert words in line and "\n" not in line


@pytest.mark.parametrize("code", [errno.ECONNREFUSED, socket.EAI_NONAME])
def test_an_error_of_a_connection_speaks_of_no_file(code):
    assert in_words(OSError(code, "port 1"), "rig").startswith("port 1")


@pytest.mark.parametrize(
    "words",
    [
        "train resume=PATH",
        "train model=PATH system=logged plant.outputs=[a] plant.low=[0] plant.high=[1]",
        "identify data=csv data.path=log.csv data.dt=SECONDS",
        "identify data=csv data.path=log.csv 'data.inputs={u: {name: u, scale: NUMBER}}'",
        "identify data=csv data.path=log.csv 'data.states={angle: HEADING}'",
        "train system=NAME",
    ],
)
def test_a_word_in_capitals_that_is_copied_as_it_stands_costs_one_line(tmp_path, words):
    (tmp_path / "log.csv").write_text("\n".join(["time,angle,u", *(f"{k / 9},{k % 7},{k % 2}" for k in range(80))]))
    command, *given = shlex.split(words)
    done = forked.run([sys.executable, str(SCRIPTS / f"{command}.py"), *given], cwd=tmp_path)
    copied = set(re.findall(r"[A-Z]{4,}", words)) | ({"scale"} if "scale" in words else set())
    assert done.returncode == 2 and any(word in done.stderr for word in copied)
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1


def test_a_broken_pipe_is_nobodys_mistake():
    with pytest.raises(BrokenPipeError):
        in_words(BrokenPipeError(32, "Broken pipe"), "train")


def test_packages_that_are_not_installed_come_with_a_command():
    missing = ModuleNotFoundError("No module named 'casadi'", name="casadi")
    assert "dynasindy[export]" in in_words(missing, "train")
    launcher = ValueError("In 'ablation': Could not find 'hydra/launcher/joblib'\n\nAvailable options: basic")
    assert "dynasindy[sweep]" in in_words(launcher, "ablation")


@pytest.mark.parametrize("word", ["sensors.channels.alpha_a.resolution=5", "+sensors.channels.alpha_a.resolution=5"])
def test_a_key_that_follows_another_one_names_it(word):
    others = ["system=tras", "sensors=bench"]
    with initialize_config_dir(str(CONF), version_base="1.3"):
        with pytest.raises(Exception, match=r"Could not") as error:
            compose("train", [*others, word])
        good = compose("train", [*others, "plant.sensors.alpha_a.resolution=5"])
    assert good.sensors.channels.alpha_a.resolution == 5
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["train.py", *others, word])
        line = in_words(error.value, "train")
    key = word.lstrip("+").partition("=")[0]
    assert key in line and "plant.sensors.alpha_a.resolution" in line


def test_a_value_in_place_of_a_group_costs_one_line():
    with initialize_config_dir(str(CONF), version_base="1.3"), pytest.raises(ConfigCompositionException) as error:
        compose("identify", ["system=pendulum", "plant.library=[u]"])
    line = in_words(error.value, "identify")
    assert "'plant.library=[u]'" in line and "\n" not in line


@pytest.mark.parametrize("instead", [[], 3, None, "step"])
def test_what_takes_a_value_from_a_group_that_is_none_names_both(instead):
    cfg = OmegaConf.create({"task": instead, "scenario": {"reference": {"max_steps": "${task.max_steps}"}}})
    with pytest.raises(ValueError, match=r"^scenario\.reference\.max_steps .*task\.max_steps"):
        check(cfg)


@pytest.mark.parametrize("late", ["false", "true", "0.5"])
def test_a_delay_of_imagined_inputs_is_a_number_or_what_older_runs_have(late):
    check(composed("train", f"planning.randomization.input_delay={late}"))
