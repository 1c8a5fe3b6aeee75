"""Other runs of the paper's experiment, which went beyond the episode at which the curves of figure 11 end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynasindy.evaluation.rows import read_rows
from dynasindy.evaluation.table import FEWEST, over_seeds
from dynasindy.viz.report.document import Part, Table, Text
from dynasindy.viz.report.sources import SETTINGS, Results, commits, listed
from dynasindy.viz.report.thresholds import LEVEL, SOON
from dynasindy.viz.style import Array

TABLE = "paper_in_full.csv"


@dataclass(frozen=True)
class Longer:
    """A run that went further than the curves.

    Attributes:
        setting: Its setting in words.
        seed: Its seed, as the table has it.
        episode: `(n,)` episodes after which it was evaluated.
        returns: `(n,)` evaluated return after each [-].
        error: `(n,)` steady-state error of the worse axis after each [rad].
        commit: Commit of its code.
    """

    setting: str
    seed: str
    episode: Array
    returns: Array
    error: Array
    commit: str

    @property
    def last(self) -> float:
        """The last episode."""
        return float(self.episode[-1])


def longer(results: Results, plant: str, experiment: str, beyond: float) -> list[Longer]:
    """Return the saved runs of an experiment that went on after episode `beyond`, by setting and seed."""
    file = results.folder / TABLE
    if experiment != "paper" or not file.is_file():
        return []
    rows = [row for row in read_rows(file) if row["system"] == plant]
    runs = []
    for name, words in SETTINGS.items():
        for seed in dict.fromkeys(row["seed"] for row in rows if row["setting"] == name):
            own = [row for row in rows if (row["setting"], row["seed"]) == (name, seed)]
            own.sort(key=lambda row: float(row["episode"]))
            episode, returns = (np.array([float(row[key]) for row in own]) for key in ("episode", "evaluated_return"))
            error = np.array([max(float(row[axis]) for axis in ("azimuth", "pitch")) for row in own])
            runs.append(Longer(words, seed, episode, returns, error, commits(own)))
    return [run for run in runs if run.last > beyond]


def courses(runs: Sequence[Longer]) -> Mapping[str, list[tuple[Array, Array]]]:
    """Return episodes and returns of each run by setting, as `average_rewards` draws them."""
    found: dict[str, list[tuple[Array, Array]]] = {}
    for run in runs:
        found.setdefault(run.setting, []).append((run.episode, run.returns))
    return found


def how_far(runs: Sequence[Longer], beyond: float) -> str:
    """Say in a caption how many seeds of which setting went how far; nothing without runs."""
    if not runs:
        return ""
    counts = Counter((run.setting, run.last) for run in runs)
    far = listed(
        f"{count} seed{'s' * (count > 1)} {_with(setting)} to episode {last:g}"
        for (setting, last), count in counts.items()
    )
    none = [_with(setting) for setting in SETTINGS.values() if setting not in {run.setting for run in runs}]
    words = f" Thin lines are other runs, which went beyond episode {beyond:g}: {far}"
    return words + f"; no seed {' or '.join(none)} did" * bool(none) + "."


def course(results: Results, runs: Sequence[Longer], case: str, beyond: float) -> list[Part]:
    """Return how the runs that went on stood where the others ended, and how they stand at their own end."""
    if not runs:
        return []
    further = sum(float(run.returns[-1]) > _at(run, run.returns, beyond) for run in runs)
    closer = sum(float(run.error[-1]) < _at(run, run.error, beyond) for run in runs)
    words = (
        f"**{case}, the whole curve**: the statements are judged up to episode {beyond:g}, which every seed of every "
        f"setting has reached. {len(runs)} other run{'s' * (len(runs) > 1)} went beyond it. From there to the end the "
        f"return rose in {further} of them, and the error of the worse axis fell in {closer}. {results.source(TABLE)} "
        "Setting and seed are those of a run; the README beside the table says with which words besides."
    )
    rows = [
        [
            run.setting,
            run.seed,
            f"{run.last:g}",
            *(f"{_at(run, values, at):.4g}" for values in (run.returns, run.error) for at in (beyond, run.last)),
            run.commit,
        ]
        for run in runs
    ]
    ends = (f"after {beyond:g}", "at the end")
    header = [
        "setting",
        "seed",
        "episodes",
        *(f"return {end}" for end in ends),
        *(f"error {end} [rad]" for end in ends),
        "commit",
    ]
    return [Text(words), Table(header, rows), *by_setting(runs)]


def by_setting(runs: Sequence[Longer]) -> list[Part]:
    """Return the settings over the whole curve, of the runs that went as far as any; nothing of fewer than two."""
    last = max(run.last for run in runs)
    whole = {name: [run for run in runs if run.setting == name and run.last == last] for name in SETTINGS.values()}
    if sum(map(bool, whole.values())) < 2:
        return []
    words = (
        f"By setting, of the runs that went on to episode {last:g}: interquartile mean over seeds and 95 % bootstrap "
        f"interval, or each seed where there are fewer than {FEWEST}. The required level is {LEVEL.value:g} "
        f"{LEVEL.unit} on the worse axis, and the paper's 800 rollouts take {SOON.value:g} {SOON.unit} to it."
    )
    rows = [
        [
            name,
            str(len(own)),
            over_seeds([float(run.returns.mean()) for run in own], 4),
            over_seeds([float(run.returns[-1]) for run in own], 4),
            over_seeds([float(run.error[-1]) for run in own]),
            f"{sum(_at(run, run.error, SOON.value) <= LEVEL.value for run in own)} of {len(own)}",
            over_seeds([_first(run) for run in own], infinite="never"),
        ]
        for name, own in whole.items()
        if own
    ]
    header = [
        "setting",
        "seeds",
        "mean return of the whole curve",
        "return at the end",
        "error at the end [rad]",
        f"at the level after {SOON.value:g}",
        "first episode at the level",
    ]
    return [Text(words), Table(header, rows)]


def _first(run: Longer) -> float:
    """Return the first episode after which the worse axis was within the required level, infinite if it never was."""
    return float(min(run.episode[run.error <= LEVEL.value], default=np.inf))


def _at(run: Longer, values: Array, episode: float) -> float:
    """Return the value after an episode, or after the last one before it that was evaluated."""
    return float(values[max(0, int(np.searchsorted(run.episode, episode, side="right")) - 1)])


def _with(setting: str) -> str:
    return setting.replace("no ", "without ", 1) if setting.startswith("no ") else f"with {setting}"
