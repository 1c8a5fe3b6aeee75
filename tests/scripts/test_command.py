"""What a command line implies is added where Hydra reads it: among the settings, whatever options stand behind them."""

from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser


@pytest.fixture
def words(monkeypatch):
    """Return the module that reads the words of a command line."""
    monkeypatch.syspath_prepend(Path(__file__).resolve().parents[2] / "scripts")
    import command

    return command


@pytest.mark.parametrize("options", [[], ["--config-dir", "own"], ["--config-dir=own"], ["--config-dir", "own", "-v"]])
def test_settings_stand_before_options_with_those_that_are_implied(words, options, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = [option for option in options if option != "-v"]
    given = ["plant.outputs=[a]", "model=a.json"]
    assert words.read_words("train", [*options, *given]) == [*given, "system=logged", *options]
    assert words.read_words("train", [given[0], *options, given[1]]) == [*given, "system=logged", *options]


def test_a_sweep_has_the_folder_of_its_settings_wherever_its_options_stand(words):
    setting, folder, *options = words.read_words("train", ["-m", "seed=0,1", "--config-dir", "own"])
    assert setting == "seed=0,1" and options == ["-m", "--config-dir", "own"]
    assert folder.startswith("hydra.sweep.dir='runs/seed-0-1_")
    two = words.read_words("train", ["-m", "experiment=smoke", "seed=0,1"])[2]
    assert two == "hydra.sweep.dir='runs/experiment-smoke-seed-0-1_fef842'"  # a later version goes on with it
    assert words.read_words("train", ["seed=0,1", "-m"])[1] == folder
    assert words.read_words("train", ["-m", "seed=0,2"])[1] != folder
    assert words.read_words("train", ["-m"])[0].startswith("hydra.sweep.dir=")
    mine = ["seed=0,1", "hydra.sweep.dir=mine", "-m"]
    assert words.read_words("train", mine) == mine


def test_folders_of_jobs_leave_out_what_all_jobs_share_where_a_disk_would_not_take_their_names(words):
    library = f"plant.library=[{','.join(f'x{k}' for k in range(60))}]"
    given = words.read_words("train", ["-m", library, "seed=0,1"])
    assert "hydra.job.config.override_dirname.exclude_keys=[plant.library]" in given
    assert not any("exclude_keys" in word for word in words.read_words("train", ["-m", "system=xi", "seed=0,1"]))


def test_a_run_that_is_resumed_keeps_its_folder(words, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"config\.yaml"):
        words.read_words("train", [f"resume={tmp_path}"])
    (tmp_path / "config.yaml").touch()
    line = words.read_words("train", [f"resume={tmp_path}", "--config-dir", "own"])
    assert line == [f"resume={tmp_path}", f"hydra.run.dir='{tmp_path}'", "--config-dir", "own"]


def test_a_setting_that_no_file_of_its_plant_gives_is_added_and_no_other(words):
    given = ["system=pendulum", "plant.bounds={theta: 2}", "plant.low=[-1]", "+plant.start={theta: 1}", "seed=1"]
    assert words.read_words("train", given) == [given[0], "++plant.bounds={theta: 2}", *given[2:]]
    with pytest.raises(ValueError, match=r"'plant\.low' does not exist"):
        words.read_words("export", ["plant.low=[1]"])


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
def test_a_heading_with_brackets_is_text_though_the_shell_took_its_quotation_marks(words, word, read):
    key, _, value = word.partition("=")
    (found,) = OverridesParser.create().parse_overrides([f"{key}={words.as_text(value)}"])
    assert {found.key_or_group: found.value()} == read
