"""The loops that docs/torchrl.md shows run, without a warning of a missing transform, and its table is right."""

import inspect
import re
import warnings
from pathlib import Path

import torch

from dynasindy.envs import ControlEnv, Tracking

PAGE = (Path(__file__).parents[1] / "docs" / "torchrl.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.S)


def lived(block, names):
    with warnings.catch_warnings(record=True) as told, torch.random.fork_rng():
        warnings.simplefilter("always")
        exec(compile(block, "docs/torchrl.md", "exec"), names)
    assert not [str(each.message) for each in told if "InitTracker" in str(each.message)]
    return names


def test_the_loops_of_the_page_run_and_the_keys_hold_what_its_table_says(capfd):
    first, second = BLOCKS
    assert "total_frames=2000" in first
    names = lived(first.replace("total_frames=2000", "total_frames=300"), {})
    printed = "".join(capfd.readouterr())
    assert "InitTracker" not in printed and "is_init" in printed
    assert len(names["buffer"]) == 300
    flight = names["flight"]
    error = flight["reference"] - flight["state"][..., :1].float()
    expected = torch.cat([flight["state"].float() / torch.tensor([1.0, 3.0]), error / 0.5], -1)  # targets span 1 rad
    torch.testing.assert_close(flight["observation"], expected)
    keys = set(re.findall(r"`(\w+)`", " ".join(re.findall(r"^\| (`.*?) \|", PAGE, re.M))))
    assert keys <= set(flight.keys()) | set(flight["next"].keys())
    assert flight["next", "truncated"].flatten().tolist() == [False] * 99 + [True]
    names = lived(second, names)
    assert len(names["buffer"]) == 300
    assert all(torch.isfinite(weight).all() for weight in names["loss"].parameters())


def test_the_settings_of_the_task_are_those_that_the_page_lists():
    (listed,) = re.findall(r"^`Tracking\((.*?)\)`", PAGE, re.M | re.S)
    assert listed.replace("\n", " ").split(", ") == list(inspect.signature(Tracking).parameters)
    (listed,) = re.findall(r"^`ControlEnv\((.*?)\)`", PAGE, re.M | re.S)
    for name in inspect.signature(ControlEnv.__init__).parameters.keys() - {"self"}:
        assert name in listed
