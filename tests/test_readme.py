"""The example of README runs as it stands, and the log that it reads is what it says."""

import math
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from plants import pendulum_rates, scipy_motion

import dynasindy
from dynasindy.envs import Step
from dynasindy.evaluation.scenarios import Scenario

REPOSITORY = Path(__file__).parents[1]


@pytest.mark.parametrize("method", ["trajectory", pytest.param("auto", marks=pytest.mark.slow)])
def test_the_lines_of_the_readme_run(monkeypatch, capsys, method):
    """In the folder of the repository, on its log; plans, forecasts and, in one case, the search are cut short."""
    block, *_ = re.findall(r"```python\n(.*?)```", (REPOSITORY / "README.md").read_text(), re.S)
    monkeypatch.chdir(REPOSITORY)
    monkeypatch.setattr(dynasindy, "identify", partial(dynasindy.identify, method=method), raising=False)
    monkeypatch.setattr(dynasindy, "plan", partial(dynasindy.plan, updates=1, rollouts=4), raising=False)
    brief = Scenario("step", Step([[0.2]]), seconds=2.0)
    monkeypatch.setattr(dynasindy, "forecast", partial(dynasindy.forecast, scenario=brief), raising=False)
    names = {}
    exec(block, names)
    assert np.abs(names["u"]).max() <= 1
    found = re.search(r"rate' = -(\S+) rate \+ (\S+) u - (\S+) sin\(angle\)\n", capsys.readouterr().out)
    assert found is not None and [float(n) for n in found.groups()] == pytest.approx([0.5, 12.0, 9.81], rel=0.02)


def test_the_log_that_is_there_to_try_is_one_of_a_pendulum():
    """angle'' = 12 u - 9.81 sin(angle) - 0.5 angle', by SciPy; an encoder of 4096 steps, and a rate with noise."""
    _, angle, rate, u = np.loadtxt(REPOSITORY / "docs" / "log.csv", delimiter=",", skiprows=1).T
    x = scipy_motion(pendulum_rates, [0, 0], u[:-1], 0.01)
    assert np.abs(angle - x[:, 0]).max() < math.pi / 4096 + 1e-4
    assert np.std(rate - x[:, 1]) == pytest.approx(0.02, rel=0.1) and abs(np.mean(rate - x[:, 1])) < 0.002
