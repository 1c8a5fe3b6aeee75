"""What `--help` shows of conf/: every key once, its value, the sentences above it."""

import re
from pathlib import Path

import pytest
from omegaconf import DictConfig, OmegaConf

CONF = Path(__file__).resolve().parents[2] / "conf"
COMMANDS = sorted(file.stem for file in CONF.glob("*.yaml"))

THING = """\
# What it is for.
# In two lines.
defaults:
  - base
  - part: big
  - override hydra/job_logging: none
  - _self_

# How many.
number: 2
# Said of both.
low: -1.0
high: 1.0
group:
  _target_: a.b
  # Letters.
  # More of them.
  inner: {a: 1}
  empty: {}
# Where it goes.
folder: ${hydra:runtime.output_dir}
hydra:
  # Of no interest.
  output_subdir: null
  run:
    dir: runs/${now:%Y}
"""
BASE = "# The base.\n\n# Of the base.\nbelow: text\n# Number of the base.\nnumber: 1\n"
BIG, SMALL = (
    "# A big one.\nsize: 9\n",
    "# @package _global_\n# A small one.\npart:\n  # Its size.\n  size: 1\nnumber: 7\n",
)


@pytest.fixture
def module(monkeypatch):
    monkeypatch.syspath_prepend(CONF.parent / "scripts")
    monkeypatch.setenv("COLUMNS", "200")
    import cli

    return cli


@pytest.fixture
def small(module, monkeypatch, tmp_path):
    """The manual of a config made for it, of a command `thing`."""
    (tmp_path / "part").mkdir()
    files = {"thing": THING, "base": BASE, "part/big": BIG, "part/small": SMALL, "part/_piece": "size: 3\n"}
    for name, text in files.items():
        (tmp_path / f"{name}.yaml").write_text(text)
    monkeypatch.setattr(module, "CONF", tmp_path)
    monkeypatch.setattr(module, "purpose", lambda name: f"What {name} does.")
    monkeypatch.setattr(module, "program", lambda name: f"run {name}")
    return lambda *words: module.help_page("thing", words).splitlines()


def test_the_page_of_a_command(small):
    page = small("--help")
    assert page[:3] == ["What thing does.", "", "What it is for. In two lines."]
    assert page[page.index("Settings:") - 2].split() == ["part=big", "or", "small"]
    settings = page[page.index("Settings:") + 1 : page.index("", page.index("Settings:"))]
    assert settings == [
        "  below=text",
        "      Of the base.",
        "  number=2",
        "      How many.",
        "  low=-1.0",
        "      Said of both.",
        "  high=1.0",
        "  group.inner={a: 1}",
        "      Letters. More of them.",
        "  group.empty={}",
        "  folder=runs/DATE_TIME",
        "      Where it goes.",
    ]


def test_a_group_shows_its_options_and_an_option_its_settings(small):
    assert small("part", "--help") == ["part=big", "    A big one.", "", "part=small", "    A small one."]
    assert small("part=small", "--help") == [
        "part=small",
        "    A small one.",
        "",
        "  part.size=1",
        "      Its size.",
        "  number=7",
    ]


def keys(node, prefix=""):
    """Yield the keys that a user may set, as a file has them."""
    for key, value in node.items_ex(resolve=False):
        if str(key).startswith("_") or (not prefix and key in ("defaults", "hydra")):
            continue
        if isinstance(value, DictConfig) and len(value):
            yield from keys(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_key_of_a_command_is_shown_once_with_all_that_is_said_of_it(module, name):
    page = module.help_page(name, ["--help"])
    shown = re.findall(r"(?:^  |  )([a-z_.]+)=", page.partition("Settings:")[2].partition("\n\n")[0], re.M)
    wanted = set(keys(OmegaConf.load(CONF / f"{name}.yaml")))
    assert wanted <= set(shown) and len(shown) == len(set(shown))
    flat = " ".join(page.split())
    for comment in re.findall(r"^# (.+)$", (CONF / f"{name}.yaml").read_text(), re.M):
        assert " ".join(comment.split()) in flat


def test_values_are_those_of_a_run_not_of_the_file(module):
    # The file has 20 episodes and planning=dyna; its experiment, gradient, changes both.
    page = module.help_page("train", [])
    assert "\n  train.episodes=1\n" in page and "\n  planning=gradient  " in page and "gate.state_error=.inf\n" in page


def test_every_option_says_at_its_top_what_it_is(module):
    for group in (folder for folder in CONF.iterdir() if folder.is_dir() and folder.name != "hydra"):
        for file in group.glob("[!_]*.yaml"):
            assert module.heading(file).endswith("."), file
