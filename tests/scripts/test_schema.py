"""A value that a key does not take costs one line that names the key, what was given and what is allowed."""

import errno
import math
import shlex
import socket
import sys
from pathlib import Path

import forked
import pytest
from hydra import compose, initialize_config_dir
from hydra.errors import ConfigCompositionException
from omegaconf import OmegaConf

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
sys.path.append(str(SCRIPTS))
from mistakes import CONF, MEANINGS, in_words  # noqa: E402
from schema import check  # noqa: E402

ALL = ("train", "ablation", "identify", "evaluate", "report", "export", "check")
NUMBER = "allowed is a finite number"


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
    ("key", "given", "said"),
    [
        ("seed", "x", "seed is 'x'; allowed is a whole number (0 to 9223372036854775807)"),
        ("seed", -1, "seed is -1; allowed is a whole number (0 to"),
        ("seed", 2**63, "allowed is a whole number (0 to"),
        ("seed", True, "seed is True"),
        ("seed", "9" * 400, "seed is '9999"),
        ("env.dtype", 2.5, "env.dtype is 2.5; allowed is a group with _target_, a dtype"),
        ("threads", 1_000_000, "threads is 1000000; allowed is a whole number (1 to"),
        ("threads", 0, "threads is 0"),
        ("train.updates_per_step", math.inf, f"train.updates_per_step is inf; {NUMBER}"),
        ("train.updates_per_step", "x", f"train.updates_per_step is 'x'; {NUMBER}"),
        ("train.episodes", 2.5, "train.episodes is 2.5; allowed is a whole number"),
        ("train.episodes", 10**12, "the limit is arbitrary"),
        ("train.recent_steps", "x", "train.recent_steps is 'x'; allowed is a whole number or null"),
        ("excitation.duration", math.inf, f"excitation.duration is inf; {NUMBER}"),
        ("excitation.duration", math.nan, f"excitation.duration is nan; {NUMBER}"),
        ("excitation.band", [0.0, "x"], f"excitation.band[1] is 'x'; {NUMBER}"),
        ("env.dt", None, f"env.dt is null; {NUMBER}"),
        ("env.dt", True, f"env.dt is True; {NUMBER}"),
        ("env.dt", "SECONDS", f"env.dt is 'SECONDS'; {NUMBER} up to 1e+19: SECONDS stands for a value of yours"),
        ("train.recent_steps", "NUMBER", "a whole number or null: NUMBER stands for a value of yours, so write that"),
        ("agent.hidden", 400, "agent.hidden is 400; allowed is a list, each a whole number"),
        ("agent.actor_lr", "x", f"agent.actor_lr is 'x'; {NUMBER}"),
        ("agent.machine_code", 1, "agent.machine_code is 1; allowed is true or false"),
        ("agent.tua", 1, "'tua' does not exist in 'agent'; allowed are actor_lr"),
        ("gate.open_below", None, "gate.open_below is null; allowed is a finite number"),
        ("excitation._target_", "dynasindy.systems.Tras", "excitation is {'_target_': 'dynasindy.systems.Tras'"),
        ("gate", None, "gate is null; allowed is a group with _target_, a Gate"),
        ("task.reward._target_", "dynasindy.tasks.Step", "a TrackingReward or null"),
        ("system._target_", "no.such", "system._target_ is 'no.such', which cannot be imported (ModuleNotFoundError"),
        ("plant.low", ["a", "b"], f"plant.low[0] is 'a'; {NUMBER}"),
        ("task.outputs", "alpha_a", "task.outputs is 'alpha_a'; allowed is a list, each text"),
        ("world_model.refinement.method", "best", "allowed is integral, one_step, trajectory, auto"),
        ("world_model.refinement", {"method": "auto"}, "refinement is {'method': 'auto'}; allowed is a group"),
        ("evaluation.every", "x", "evaluation.every is 'x'; allowed is a whole number"),
        ("scenario.seconds", "x", f"scenario.seconds is 'x'; {NUMBER}"),
    ],
)  # fmt: skip
def test_a_bad_value_is_named(key, given, said):
    cfg = composed("train", "experiment=smoke", "planning=dyna")
    OmegaConf.update(cfg, key, given, merge=False, force_add=True)
    with pytest.raises(ValueError, match=r".") as error:
        check(cfg)
    assert said in str(error.value) and "\n" not in str(error.value)


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
    cfg = composed("train")
    OmegaConf.update(cfg, key, given, merge=False)
    check(cfg)
    found = OmegaConf.select(cfg, key)
    assert repr(found) == repr(taken)


@pytest.mark.parametrize(
    ("command", "words", "said"),
    [
        ("export", "formats=[png]", "formats[0] is 'png'; allowed is c, onnx, fmu, model"),
        ("export", "fmi=1", "fmi is 1; allowed is 2, 3"),
        ("check", "grid=1", "grid is 1; allowed is a whole number (2 to 100"),
        ("check", "low=[x]", "low[0] is 'x'"),
        ("evaluate", "formats=[onnx]", "formats[0] is 'onnx'; allowed is png, svg"),
    ],
)
def test_formats_are_those_of_the_command(command, words, said):
    with pytest.raises(ValueError, match=r".") as error:
        check(composed(command, words))
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("word", "hint"),
    [
        ("planning.learning_rate", "'lr'"),
        ("planning.lrr", "'lr'"),
        ("learning_rate", "'agent.actor_lr' or 'agent.critic_lr' or 'planning.lr'"),
        ("episodes", "'train.episodes' or 'scenario.episodes'"),
        ("task.n_episodes", "'train.episodes' or 'scenario.episodes'"),
        ("planning.random_seed", "'seed'"),
        ("duration", "'excitation.duration'"),  # and not evaluation, which is spelt alike
        ("agent.discount", "'gamma'"),
    ],
)
def test_a_key_by_another_name_is_offered_where_it_stands(monkeypatch, word, hint):
    monkeypatch.setattr(sys, "argv", ["train.py", f"{word}=1"])
    with initialize_config_dir(str(CONF), version_base="1.3"), pytest.raises(ConfigCompositionException) as error:
        compose("train", [f"{word}=1"])
    line = in_words(error.value, "train")
    assert line.endswith(f"; did you mean {hint}?") and "; allowed are " in line


def test_a_key_that_means_nothing_that_exists_comes_with_those_of_its_group(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["train.py", "checkpoint.xyz=1"])
    with initialize_config_dir(str(CONF), version_base="1.3"), pytest.raises(ConfigCompositionException) as error:
        compose("train", ["checkpoint.xyz=1"])
    assert in_words(error.value, "train") == "'xyz' does not exist in 'checkpoint'; allowed are every"


@pytest.mark.parametrize("words", MEANINGS, ids=sorted(map(min, MEANINGS)))
def test_each_group_of_names_that_mean_the_same_has_one_that_exists(words):
    written = "\n".join(file.read_text() for file in CONF.rglob("*.yaml"))
    assert any(f"{word}:" in written.split() for word in words), words


def test_a_plant_in_the_place_of_what_is_known_of_one_is_looked_for_among_the_systems():
    cfg = OmegaConf.create({"plant": "tras"})
    with pytest.raises(ValueError, match=r"^plant=tras is a name, .*: did you mean system=tras\?$"):
        check(cfg)


def test_what_is_not_given_is_missed():
    cfg = composed("train", "~replay.capacity")
    with pytest.raises(ValueError, match=r"replay\.capacity is not given; allowed is a whole number"):
        check(cfg)


def test_the_file_of_a_config_is_named():
    with pytest.raises(ValueError, match=r"^run/config\.yaml: seed is -1"):
        check(composed("train", "seed=-1"), "run/config.yaml")
    with pytest.raises(ValueError, match=r"^run/config\.yaml: 'gate' is not given; restore it"):
        check(composed("train", "~gate"), "run/config.yaml")


def test_identify_takes_world_models_without_a_refinement():
    check(composed("identify", "world_model=sindy_paper"))
    assert composed("identify").world_model.refinement.method == "auto"
    assert composed("train").world_model.refinement.method == "integral"


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda folder: (folder / "none" / "file").write_text(""), "none/file: it does not exist: correct the path"),
        (lambda folder: folder.write_text(""), ": it is a folder: give a file"),
        (lambda folder: (folder / ("x" * 300)).write_text(""), ": the name is too long: shorten it"),
        (lambda folder: Path("/dev/full").write_text("x"), "the disk is full: free some of it"),
        (lambda folder: Path("/proc/x/y").mkdir(parents=True), "/proc/x: it does not exist"),
    ],
)
def test_what_the_system_refuses_costs_one_line(tmp_path, make, words):
    with pytest.raises(OSError, match=r".") as error:
        make(tmp_path)
    line = in_words(error.value, "train")
    assert words in line and "\n" not in line


@pytest.mark.parametrize("code", [errno.ECONNREFUSED, socket.EAI_NONAME])
def test_an_error_of_a_connection_speaks_of_no_file(code):
    assert in_words(OSError(code, "nobody listens at port 1"), "rig") == "nobody listens at port 1"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("evaluate run=PATH", "PATH is not a run folder"),
        ("check run=FOLDER", "FOLDER does not exist; give a controller that was saved, or the folder of a run"),
        ("export run=PATH", "PATH does not exist; give a controller"),
        ("train resume=PATH", "resume=PATH is no run folder"),
        ("train model=PATH system=logged plant.outputs=[a] plant.low=[0] plant.high=[1]", "PATH: it does not exist"),
        ("identify data=csv data.path=FILE", "FILE does not exist"),
        ("identify data=csv data.path=log.csv data.dt=SECONDS", "SECONDS stands for a value of yours"),
        ("identify data=csv data.path=log.csv data.time=HEADING", "none of them is called HEADING."),
        ("identify data=csv data.path=log.csv 'data.inputs={u: {name: u, scale: NUMBER}}'", "scale (a number, not 0)"),
        ("identify data=csv data.path=log.csv 'data.states={angle: HEADING}'", "has no column 'HEADING'"),
        ("train system=NAME", "'NAME' does not exist in 'system'"),
        ("train sensors=NAME", "'NAME' does not exist in 'sensors'"),
        ("rig system=tras rig=udp rig.host=ADDRESS", "(ADDRESS, port 9870); give the rig's rig.host"),
    ],
)
def test_a_word_in_capitals_that_is_copied_as_it_stands_costs_one_line(tmp_path, words, said):
    (tmp_path / "log.csv").write_text("\n".join(["time,angle,u", *(f"{k / 9},{k % 7},{k % 2}" for k in range(80))]))
    command, *given = shlex.split(words)
    done = forked.run([sys.executable, str(SCRIPTS / f"{command}.py"), *given], cwd=tmp_path)
    assert done.returncode == 2 and said in done.stderr
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1


def test_a_broken_pipe_is_nobodys_mistake():
    with pytest.raises(BrokenPipeError):
        in_words(BrokenPipeError(32, "Broken pipe"), "train")


def test_packages_that_are_not_installed_come_with_a_command():
    missing = ModuleNotFoundError("No module named 'casadi'", name="casadi")
    assert "pip install 'dynasindy[export]'" in in_words(missing, "train")
    launcher = ValueError("In 'ablation': Could not find 'hydra/launcher/joblib'\n\nAvailable options: basic")
    assert "pip install 'dynasindy[sweep]', or choose hydra/launcher=basic" in in_words(launcher, "ablation")


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
    assert line == f"'{key}' follows another key; give plant.sensors.alpha_a.resolution instead"


GROUPS = sorted({file.parent.relative_to(CONF).as_posix() for file in CONF.glob("*/**/*.yaml")})


def test_a_value_in_place_of_a_group_costs_one_line():
    with initialize_config_dir(str(CONF), version_base="1.3"), pytest.raises(ConfigCompositionException) as error:
        compose("identify", ["system=pendulum", "plant.library=[u]"])
    line = in_words(error.value, "identify")
    assert line.startswith("'plant.library=[u]' gives a group of keys where one value is wanted, or one value where a")


@pytest.mark.parametrize("instead", [[], 3, None, "step"])
def test_what_takes_a_value_from_a_group_that_is_none_names_both(instead):
    cfg = OmegaConf.create({"task": instead, "scenario": {"reference": {"max_steps": "${task.max_steps}"}}})
    with pytest.raises(ValueError, match=r"^scenario\.reference\.max_steps is taken from task\.max_steps, where a"):
        check(cfg)


@pytest.mark.parametrize("late", ["false", "true", "0.5"])
def test_a_delay_of_imagined_inputs_is_a_number_or_what_older_runs_have(late):
    check(composed("train", f"planning.variation.late={late}"))
