"""What a command line implies is added where Hydra reads it: among the settings, whatever options stand behind them."""

from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser


@pytest.fixture
def as_text(monkeypatch):
    """Return the function that reads a word."""
    monkeypatch.syspath_prepend(Path(__file__).resolve().parents[2] / "scripts")
    import command

    return command.as_text


@pytest.fixture
def completed(monkeypatch):
    """Return the words of a command with what they imply."""
    monkeypatch.syspath_prepend(Path(__file__).resolve().parents[2] / "scripts")
    import command

    def complete(*words):
        return command.complete([*words])

    return complete


@pytest.mark.parametrize("options", [[], ["--config-dir", "own"], ["--config-dir=own"], ["--config-dir", "own", "-v"]])
def test_settings_that_are_implied_stand_behind_those_that_were_given(completed, options):
    given = ["targets=[1]", "model=a.json"]
    assert completed(*given, *options) == [*given, "system=logged", *options]


def test_a_sweep_has_the_folder_of_its_settings_wherever_its_options_stand(completed):
    *before, folder, option, own = completed("-m", "seed=0,1", "--config-dir", "own")
    assert before == ["-m", "seed=0,1"] and [option, own] == ["--config-dir", "own"]
    assert folder.startswith("hydra.sweep.dir='runs/seed-0-1_")
    options = ["--config-dir", "own", "-m"]
    assert completed("seed=0,1", *options) == ["seed=0,1", folder, *options]
    assert completed("-m", "seed=0,2")[2] != folder
    assert completed("-m")[1].startswith("hydra.sweep.dir=")
    assert completed("-m", "seed=0,1", "hydra.sweep.dir=mine") == ["-m", "seed=0,1", "hydra.sweep.dir=mine"]


def test_a_run_that_is_resumed_keeps_its_folder(completed, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"config\.yaml"):
        completed(f"resume={tmp_path}")
    (tmp_path / "config.yaml").touch()
    line = completed(f"resume={tmp_path}", "--config-dir", "own")
    assert line == [f"resume={tmp_path}", f"hydra.run.dir='{tmp_path}'", "--config-dir", "own"]


@pytest.mark.parametrize(
    ("word", "read"),
    [
        ("data.time=Time [ms]", {"data.time": "Time [ms]"}),
        ("data.time=Zeit (s)", {"data.time": "Zeit (s)"}),
        ("data.states=[T [degC], h (m)]", {"data.states": ["T [degC]", "h (m)"]}),
        ("data.states=['T [degC]',h]", {"data.states": ["T [degC]", "h"]}),
        ("plant.low=[-0.5,1]", {"plant.low": [-0.5, 1]}),
    ],
)
def test_a_heading_with_brackets_is_text_though_the_shell_took_its_quotation_marks(as_text, word, read):
    (found,) = OverridesParser.create().parse_overrides([as_text(word)])
    assert {found.key_or_group: found.value()} == read
