"""What `--help` shows of conf/: the files of a command, with the sentences above their keys."""

import re
from pathlib import Path

import pytest

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
    assert page[0] == "What thing does."
    assert next(line for line in page if line.startswith("  part=")).split() == ["part=big", "or", "small"]
    first, second = (page.index(line) for line in ("number: 1", "number: 2"))  # the base, then what the command changes
    assert page[first - 1] == "# Number of the base." and page[second - 1] == "# How many." and first < second
    assert page[page.index("folder: runs/DATE_TIME") - 1] == "# Where it goes."
    assert not [line for line in page if re.match("hydra:|defaults:|  output_subdir", line)]


def test_a_group_shows_its_options_and_an_option_its_file(small):
    assert small("part", "--help") == ["part=big", "    A big one.", "", "part=small", "    A small one."]
    assert small("part=small", "--help") == ["part=small", *(f"    {line}" for line in SMALL.splitlines()[1:])]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_key_of_a_command_is_shown_with_all_that_is_said_of_it(module, name):
    page = module.help_page(name, ["--help"]).splitlines()
    own = re.split(r"^(?:defaults|hydra):\n(?: .*\n|\n)*", (CONF / f"{name}.yaml").read_text(), flags=re.M)
    lines = [line for line in "".join(own).splitlines() if line and "hydra:runtime" not in line]
    assert lines and set(lines) <= set(page)


def test_what_the_default_experiment_changes_is_shown(module):
    # The file has 20 episodes and planning=dyna; its experiment, gradient, changes both.
    page = module.help_page("train", [])
    assert page.rindex("episodes: 1\n") > page.index("episodes: 20\n") and "\n  planning=gradient  " in page


def test_every_option_says_at_its_top_what_it_is(module):
    for group in (folder for folder in CONF.iterdir() if folder.is_dir() and folder.name != "hydra"):
        for file in group.glob("[!_]*.yaml"):
            assert module.heading(file).endswith("."), file
