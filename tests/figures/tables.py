"""The files of docs/results, read for the figures of pages, and how pages write figures."""

import csv
import json
from collections.abc import Callable, Sequence
from functools import cache

import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from ties import REPOSITORY

from dynasindy.evaluation.statistics import interquartile_mean
from dynasindy.evaluation.table import over_seeds

TRIAL = "a trial whose run folders were not kept; the page says so"

RESULTS = REPOSITORY / "docs" / "results"
AXES = ("alpha_a", "alpha_p")
Row = dict[str, str]


@cache
def table(name: str) -> tuple[Row, ...]:
    """Return the rows of a CSV file of docs/results."""
    with (RESULTS / name).open(newline="") as file:
        return tuple(csv.DictReader(file))


@cache
def record(name: str) -> dict:
    """Return a JSON file of docs/results."""
    return json.loads((RESULTS / name).read_text())


def rows(name: str, **wanted: object) -> list[Row]:
    """Return the rows that have the wanted cells; there is at least one."""
    found = [row for row in table(name) if all(row[key] == str(value) for key, value in wanted.items())]
    assert found, f"{name} has no row with {wanted}"
    return found


def numbers(found: Sequence[Row], column: str) -> list[float]:
    """Return a column, an empty cell as infinite."""
    return [float(row[column] or "inf") for row in found]


def middle(values: Sequence[float]) -> float:
    """Return the interquartile mean."""
    return interquartile_mean(torch.tensor(list(values), dtype=torch.float64)).item()


def cell(values: Sequence[float], digits: int = 4) -> str:
    """Return a figure over seeds as the tables of the ablation have it."""
    return over_seeds(values, digits, "never")


def short(value: float, places: int = 4) -> str:
    """Return a number without the zero before its point: .0006; of 1 and above three digits."""
    return f"{value:.{places}f}".removeprefix("0") if value < 1 else f"{value:.2f}"


def pair(of: Callable[[str], float], places: int = 4, between: str = " / ", axes: Sequence[str] = AXES) -> str:
    """Return azimuth and pitch: .0006 / .0011."""
    return between.join(short(of(axis), places) for axis in axes)


@cache
def setting(key: str, *overrides: str, page: str = "train") -> object:
    """Return a value of conf/."""
    with initialize_config_dir(str(REPOSITORY / "conf"), version_base="1.3"):
        return OmegaConf.select(compose(page, list(overrides)), key)
