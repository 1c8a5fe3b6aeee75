"""What keys and configs may hold: what is not allowed costs one line that names the key and what is."""

import importlib
import math
import re
import shlex
from pathlib import Path

import forked
import pytest
from command import in_words, read_words
from configs import composed
from omegaconf import OmegaConf
from settings import check

ALL = ("train", "ablation", "identify", "evaluate", "report", "export", "check")


def test_the_file_of_a_plant_without_its_header_is_named_as_such(tmp_path):
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "mine.yaml").write_text("system: {_target_: a.B}\nplant: {outputs: [p]}\n")
    with pytest.raises(ValueError, match="# @package _global_"):
        check(composed("train", "system=mine", f"hydra.searchpath=[file://{tmp_path}]"))


@pytest.mark.parametrize("command", ALL)
def test_what_conf_holds_is_allowed_and_stays_as_it_is(command):
    cfg = composed(command)
    before = OmegaConf.to_yaml(cfg)
    check(cfg)
    assert OmegaConf.to_yaml(cfg) == before


@pytest.mark.parametrize(
    ("key", "given", "taken"),
    [
        ("train.episodes", 10.0, 10),
        ("gate.open_below", math.inf, math.inf),
        ("agent.hidden", [64, 32.0], [64, 32]),
        ("folder", 2026, "2026"),
    ],
)
def test_a_number_of_another_type_becomes_what_is_wanted(key, given, taken):
    cfg = composed("train")
    OmegaConf.update(cfg, key, given, merge=False)
    check(cfg)
    found = OmegaConf.select(cfg, key)
    assert repr(found) == repr(taken)


@pytest.mark.parametrize(
    ("command", "words", "allowed"),
    [
        ("export", "formats=[png]", ("c", "onnx", "fmu", "model")),
        ("export", "fmi=1", ("2", "3")),
        ("evaluate", "formats=[onnx]", ("png", "svg")),
    ],
)
def test_formats_are_those_of_the_command(command, words, allowed):
    with pytest.raises(ValueError, match=words.partition("=")[0]) as error:
        check(composed(command, words))
    assert all(each in str(error.value) for each in allowed)


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("+plant.strat={theta: 1}", "'start'"),
        ("+plant.signals.stepp=[[0.1]]", "'step'"),
        ("+plant.mass=2", "'mass'"),
    ],
)
def test_a_setting_of_a_plant_that_nothing_reads_is_refused(word, meant):
    cfg = composed("train", "system=pendulum", word)
    with pytest.raises(ValueError, match=meant):
        check(cfg)
    check(cfg, "run/config.yaml")  # what another version wrote is looked at by what it builds


@pytest.mark.parametrize("key", ["plant.mass", "plant.signals.ramp"])
def test_a_plant_may_read_settings_of_its_own(key):
    check(composed("train", "system=pendulum", f"+{key}=2", f"+system.mass=${{{key}}}"))


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
    line = in_words(error.value)
    assert words in line and "\n" not in line


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
    done = forked.call(command, *given, cwd=tmp_path)
    copied = set(re.findall(r"[A-Z]{4,}", words)) | ({"scale"} if "scale" in words else set())
    assert done.returncode == 2 and any(word in done.stderr for word in copied)
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1


@pytest.mark.parametrize("word", ["sensors.channels.alpha_a.resolution=5", "+sensors.channels.alpha_a.resolution=5"])
def test_a_key_that_follows_another_one_names_it(word):
    others = ["system=tras", "sensors=bench"]
    good = composed("train", *others, "plant.sensors.alpha_a.resolution=5")
    assert good.sensors.channels.alpha_a.resolution == 5
    key = word.lstrip("+").partition("=")[0]
    with pytest.raises(ValueError, match=rf"'{key}' .* plant\.sensors\.alpha_a\.resolution"):
        read_words("train", [*others, word])


def test_a_value_in_the_place_of_a_group_that_others_read_is_refused_in_plain_words():
    with pytest.raises(ValueError, match=r"group of keys, from which .* is not given; give it as conf/ does"):
        check(composed("train", "plant=3"))
    with pytest.raises(ValueError, match=r"^run/config.yaml: .*group of keys"):
        check(composed("train", "plant=3"), "run/config.yaml")


def test_no_admitted_class_takes_a_file():
    import inspect
    import pkgutil

    import settings

    import dynasindy

    seen = 0
    for found in pkgutil.walk_packages(dynasindy.__path__, "dynasindy."):
        for part in vars(importlib.import_module(found.name)).values():
            if inspect.isclass(part) and part.__module__ == found.name and settings.is_part(part, "dynasindy"):
                seen += 1
                given = set(inspect.signature(part.__init__).parameters)
                assert not given & {"path", "file", "folder", "root", "command", "filename"}, part
    assert seen > 50
