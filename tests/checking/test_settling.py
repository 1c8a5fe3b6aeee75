"""The end of a step takes as long as the slowest part of a linear loop says."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from dynasindy.checking import Thresholds, check_verdict
from dynasindy.checking.check import Settings, check
from dynasindy.checking.linear_loop import settling
from dynasindy.checking.verdict import check_record


def test_a_fiftieth_is_left_when_the_exponential_says_so():
    """0.9^k is 0.02 at k = ln 0.02 / ln 0.9 = 37.1; a slow part that begins as 5 % takes ln 0.4 / ln 0.99 = 91.2."""
    fast, slow = np.diag([0.9, 0.5]), np.diag([0.9, 0.99])
    mixed = np.array([[0.9, 0.0], [0.0, 0.99]])
    mixed = np.array([[1.0, 1.0], [0.0, 1.0]]) @ mixed @ np.array([[1.0, -1.0], [0.0, 1.0]])  # the output sees both
    away = np.array([[1.0, 0.3], [1.0, 0.3], [1.0, 0.05]])
    found = settling(np.stack([fast, slow, mixed]), away, [0], np.array([1.0]), 100)
    assert found.tolist() == [38.0, 38.0, 92.0]
    assert settling(np.eye(1)[None], np.ones((1, 1)), [0], np.ones(1), 10).tolist() == [math.inf]
    assert settling(fast[None], away[:1], [0], np.zeros(1), 10).tolist() == [0.0]


def test_a_cart_on_a_spring_settles_as_its_eigenvalues_on_paper_say(loops, carts):
    """p'' = 2 (r - p) - 2.5 p' - p, sampled every 0.1 s: within 2 % when it has swung in, as NumPy moves it."""
    settings = Settings((-0.4,), (0.4,), points=2, seconds=6.0, grid=3, draws=0)
    found = check(loops(model=carts(spring=1.0)), settings)
    assert found.spread.settling is not None and found.spread.settling.shape == (2, 5)
    x, last = np.array([-0.8 * 2 / 3, 0.0]), 0
    a, b = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([0.0, 1.0])
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[:2, 2] = a * 0.1, b * 0.1
    power, term = np.eye(3), np.eye(3)
    for k in range(1, 20):
        term = term @ whole / k
        power = power + term
    for k in range(200):
        last = k + 1 if abs(x[0]) > 0.02 * 0.8 else last
        x = (power @ np.append(x, -2.0 * x[0] - 2.5 * x[1]))[:2]
    assert found.spread.settling[:, -1].tolist() == pytest.approx([0.1 * last] * 2)
    (line,) = (each for each in check_verdict(found) if each.name == "settling")
    assert line.good and "slowest" in line.words
    (line,) = (each for each in check_verdict(found, Thresholds(settled=0.2)) if each.name == "settling")
    assert line.weak and line.words.endswith("threshold: 1.2 s")
    slow = torch.full_like(found.spread.settling, math.inf)
    (line,) = (
        e for e in check_verdict(replace(found, spread=replace(found.spread, settling=slow))) if e.name == "settling"
    )
    assert line.weak and "than" in line.words
    apart = torch.tensor([[1.0, 2.0, 3.0, 4.0, 5.0], [7.0, 1.0, 1.0, 6.0, 8.0]], dtype=torch.float64)
    unlike = replace(found, spread=replace(found.spread, settling=apart))  # the slower one of both ways counts
    (line,) = (each for each in check_verdict(unlike) if each.name == "settling")
    assert "slowest" in line.words
    assert [change["settling"] for change in check_record(unlike)["changes"]] == [7.0, 2.0, 3.0, 6.0]
    part = found.spread.radius.clone()
    part[0, 0] = 1.01  # at one of both targets the first plant is not stable
    (line,) = (
        e for e in check_verdict(replace(found, spread=replace(found.spread, radius=part))) if e.name == "settling"
    )
    assert "slowest" in line.words
    assert check_record(replace(found, spread=replace(found.spread, radius=part)))["changes"][0]["settling"] is None
    none = replace(found.spread, radius=torch.full_like(part, 1.01))
    assert "settling" not in [each.name for each in check_verdict(replace(found, spread=none))]
