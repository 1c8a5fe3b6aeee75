"""Write the tables of README and docs anew from the files of docs/results: `python scripts/tables.py`.

A page holds `<!-- table: NAME -->` and `<!-- end -->`; what stands between them are the rows of the function of that
name below. A number that changes in a file changes in the pages by this command, and by nothing else.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path

import pandas as pd
import torch
import yaml

from dynasindy.evaluation.ablation import Level, read_ablation, to_markdown
from dynasindy.evaluation.statistics import interquartile_mean, over_seeds
from dynasindy.safe_io import write_text

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
BLOCK = re.compile(r"(<!-- table: (\w+) -->\n\n).*?(\n\n<!-- end -->)", re.S)
AXES, WORST = ("azimuth", "pitch"), ("azimuth_worst", "pitch_worst")
ROLLOUTS = ("rollouts_800", "rollouts_400", "rollouts_0")
LAST = {"xi": 12, "tras": 16}
"""Episodes after which the controls of the ablation are compared."""
LABORATORY = 12
"""Plants known by logs that stand in a laboratory; those behind them are out of textbooks."""
TABLES: dict[str, Callable[[], str]] = {}
"""The tables by name, each as Markdown."""
Rows = Iterator[Sequence[object]]


def table(header: str) -> Callable[[Callable[[], Rows]], Callable[[], Rows]]:
    """Make a table of the rows that a function yields; `header` is its first line without the outer bars."""

    def add(rows: Callable[[], Rows]) -> Callable[[], Rows]:
        columns = header.split(" | ")
        TABLES[rows.__name__] = lambda: "\n".join(
            f"| {' | '.join(map(str, line))} |" for line in (columns, ["---"] * len(columns), *rows())
        )
        return rows

    return add


def pages() -> dict[Path, str]:
    """Return the pages that hold tables, with each table as the files have it now."""
    files = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *RESULTS.glob("*.md")]
    texts = {file: file.read_text(encoding="utf-8") for file in files}
    found = {
        file: BLOCK.sub(lambda block: block[1] + TABLES[block[2]]() + block[3], text)
        for file, text in texts.items()
        if BLOCK.search(text)
    }
    return found | {RESULTS / "ablation.md": to_markdown(read_ablation(RESULTS / "ablation.csv"), Level())}


def main() -> None:
    """Write every page whose tables differ from the files."""
    for file, text in pages().items():
        if file.read_text(encoding="utf-8") != text:
            write_text(file, text)
            print(file.relative_to(ROOT))


@cache
def read(name: str) -> pd.DataFrame:
    """Return a CSV file of docs/results, each cell as text."""
    return pd.read_csv(RESULTS / name, dtype=str, keep_default_na=False)


def rows(name: str, **wanted: object) -> pd.DataFrame:
    """Return the rows that have the wanted cells; there is at least one."""
    found = read(name)
    for key, value in wanted.items():
        found = found[found[key] == str(value)]
    if found.empty:
        raise ValueError(f"{name} has no row with {wanted}")
    return found


def numbers(found: pd.DataFrame, column: str) -> pd.Series[float]:
    """Return a column, an empty cell as infinite."""
    return found[column].replace("", "inf").astype(float)


def short(value: float, places: int = 4) -> str:
    """Return a number without the zero before its point: .0006; of 1 and above three digits."""
    return f"{value:.{places}f}".removeprefix("0") if value < 1 else f"{value:.2f}"


def pair(values: Iterable[float]) -> str:
    """Return azimuth and pitch: .0006 / .0011."""
    return " / ".join(map(short, values))


def worst(found: pd.DataFrame, axes: Sequence[str] = AXES) -> str:
    """Return the worst seed on each axis."""
    return pair(numbers(found, axis).max() for axis in axes)


def seeds(values: Iterable[float]) -> str:
    """Return the interquartile mean over seeds and its interval."""
    return over_seeds([*values], 4, "never").replace("never [never, never]", "never")


def runs(plant: str, setting: str, experiment: str = "dyna") -> pd.DataFrame:
    """Return the rows of a setting of the ablation, one per seed."""
    return rows("ablation.csv", system=plant, experiment=experiment, setting=setting)


def worse_axis(plant: str, setting: str, experiment: str, episode: int) -> pd.Series[float]:
    """Return the error of the worse axis of each seed after an episode."""
    found = rows("ablation_curves.csv", system=plant, experiment=experiment, setting=setting, episode=episode)
    return found.filter(like="evaluated_steady_state_error").astype(float).max(axis=1)


@table("plant | data | error, azimuth / pitch | time on one core")
def main_job() -> Rows:
    """Yield the errors of the main job after 10 s of data, of the worst of ten seeds."""
    for plant in ("tras", "xi"):
        found = rows("gradient.csv", case="step", plant=plant, plant_seconds=10.0)
        yield f"`{plant}`", "10 s", f"{worst(found)} rad", f"{numbers(found, 'cpu_seconds').max():.0f} s"


@table("policy | data | error, azimuth / pitch [rad] | RMSE, azimuth / pitch [rad]")
def policies() -> Rows:
    """Yield the scores of the controllers that lie in the repository."""
    for plant in ("tras", "xi"):
        file = RESULTS / "policies" / plant / "origin.json"
        score = json.loads(file.read_text())["evaluation"]
        errors = (_score(score, metric) for metric in ("steady_state_error", "rmse"))
        yield f"[`{plant}`]({file.relative_to(ROOT)})", "30 s", *errors


@table("scenario | RMSE [rad] | mean abs error of the last 5 s [rad] | return")
def scenarios() -> Rows:
    """Yield what the policy of the main job makes of each scenario."""
    for name in ("step", "sine", "square", "wind", "noise", "delay", "detuned"):
        score = json.loads((RESULTS / f"runs/tras_gradient/evaluation/{name}.json").read_text())
        errors = (_score(score, metric) for metric in ("rmse", "steady_state_error"))
        yield f"`{name}`", *errors, f"{score['return']:.1f}"


@table("case | plant | real data | seeds | worst seed | CPU [s] | to reach")
def gradient() -> Rows:
    """Yield the worst seed of each case of planning by gradient."""
    reach = {
        ("step", "tras", 10): ".004",
        ("step", "tras", 30): ".002",
        ("step", "xi", 10): ".002",
        ("sine", "tras", 10): ".003/.009 (LQI)",
        ("square", "tras", 10): ".077/.110 (LQI)",
        ("sine", "xi", 10): ".001/.002 (LQI)",
        ("square", "xi", 10): ".083/.102 (LQI)",
        ("noise", "tras", 70): ".02 within 3 episodes",
        ("noise", "xi", 70): ".02 within 3 episodes",
        ("bench", "tras", 10): ".002",
        ("bench", "xi", 10): ".002",
        ("bench_delay", "tras", 10): ".004",
        ("bench_delay", "xi", 10): ".004",
        ("detuned", "tras", 10): ".02 (10 of 10)",
        ("friction_alone", "trms33", 10): ".02 (10 of 10)",
    }
    found = read("gradient.csv").astype({"plant_seconds": float})
    found = found[~found.case.isin(["friction", "unseen", "unseen_moving"]) & found.plant_seconds.isin([10, 30, 70])]
    found = found[~found.scenario.str.contains("_inputs|_nis")]
    keys = ["case", "plant", "plant_seconds", "scenario"]
    for (case, plant, seconds, scenario), own in found.groupby(keys, sort=False):
        words = f"`{case}`" + (f", {scenario}, RMSE" if case == "moving" else "")
        words += ", integral action" if scenario.endswith("integral") else ""
        errors = worst(own) + (f" ({worst(own, WORST)})" if case in ("detuned", "friction_alone") else "")
        target = reach.get((scenario if case == "moving" else case, plant, seconds), "")
        cpu = f"{numbers(own, 'cpu_seconds').max():.0f}"
        yield words, f"`{plant}`", f"{seconds:g} s", len(own), errors, cpu, target


@table("situation | policy of | plant | seeds | error | worst seed | worst single reference")
def unseen() -> Rows:
    """Yield the situations that nothing was tuned on."""
    policy = {"unseen": "step", "unseen_moving": "moving"}
    found = read("gradient.csv")
    found = found[found.case.isin(policy)]
    for (case, scenario, plant), own in found.groupby(["case", "scenario", "plant"], sort=False):
        middle = (interquartile_mean(torch.tensor(numbers(own, axis).to_numpy())).item() for axis in AXES)
        who = f"`{scenario}`", f"`{policy[case]}`", f"`{plant}`", len(own)
        yield *who, pair(middle), worst(own), worst(own, WORST)


MODELS = {
    **{"ours": "ours", "ours with structure": "with structure", "ARX": "ARX", "subspace": "subspace"},
    **{"pysindy": "PySINDy", "last value held": "last value held"},
}
"""Models of every rig, and what they are called in the table."""


@table(f"rig | error | {' | '.join(MODELS.values())} | another")
def rig_models() -> Rows:
    """Yield the newest errors of models of real plants at horizons and over whole test logs."""
    found = read("rigs.csv")
    newest = found[~found.metric.str.contains(" over ")].drop_duplicates(["rig", "metric", "model"], keep="last")
    for (rig, metric, unit), own in newest.groupby(["rig", "metric", "unit"], sort=False):
        cells = dict(zip(own.model, own.value, strict=True))
        if "ARX" in cells:
            others = (name for name in ("ARX with a cubic", "inverse dynamics", "second-order linear") if name in cells)
            another = ", ".join(f"{name} {cells[name]}" for name in others)
            yield rig, f"{metric} [{unit}]", *(cells.get(name, "") for name in MODELS), another


@table("rig | model | error | value")
def rigs() -> Rows:
    """Yield what was scored before all rigs had the same simple models beside them."""
    found = read("rigs.csv")
    for row in found[: int((found.model == "ARX").to_numpy().argmax())].itertuples():
        yield row.rig, row.model, f"{row.metric} [{row.unit}]", row.value


@table("plant | held to 1 % | error of the worst seed | data")
def plants() -> Rows:
    """Yield the plants that were given as equations."""
    return _plants(behind_bench=False)


@table("plant | held to 1 % | error of the worst seed | data")
def bench_plants() -> Rows:
    """Yield the plants behind the sensors of a bench."""
    return _plants(behind_bench=True)


@table("plant, what is measured | promised | held to 1 % | error of the worst seed")
def logs() -> Rows:
    """Yield the plants that are known by a log alone."""
    for plant, facts in [*_logged_plants().items()][:LABORATORY]:
        found = rows("logs.csv", plant=plant)
        promised = found[found.foretold == "CONTROLLED"].seed.nunique()
        missed = found[numbers(found, "error_percent") > 1].seed.nunique()
        of = found.seed.nunique()
        yield facts["title"], f"{promised} of {of}", f"{of - missed} of {of}", _percent(found)


@table("plant, what is measured | at first | error at first | since | error since")
def textbook_logs() -> Rows:
    """Yield the plants out of textbooks, at first and since."""
    words = {"CONTROLLED": "promised", "NOT promised": "not promised", "no controller": "no controller"}
    for plant, facts in [*_logged_plants().items()][LABORATORY:]:
        cells = []
        for file in ("logs_first.csv", "logs.csv"):
            found = read(file).query("plant == @plant and seed == '0'")
            ended = "not ended" if (file, plant) == ("logs.csv", "cylinder") else "not run"
            cells += [ended, "none"] if found.empty else [words[found.foretold.iloc[0]], _percent(found)]
        yield facts["title"], *cells


@table("case | plant | by | error | CPU [s] | ms per action")
def peers() -> Rows:
    """Yield ours beside the strongest peers: errors of controllers, the worst target in brackets, and of models."""
    keys = ["case", "plant", "peer", "version", "cpu_seconds", "ms_per_action"]
    for (case, plant, peer, version, *costs), found in read("peers.csv").groupby(keys, sort=False):
        if len(found) == 4:
            words = "{} / {} ({} / {}) rad".format(*found.value)
        else:
            words = f"{found.value.iloc[0]} {found.measure.iloc[0].removeprefix('RMSE, ')}"
        yield case, f"`{plant}`", "ours" if peer == "ours" else f"{peer} {version}", words, *costs


@table("case | by | what is measured | must reach | value")
def identification() -> Rows:
    """Yield what identification had to reach from exact data, and what was measured."""
    for row in read("identification.csv").itertuples():
        if row.case in ("xi_10s", "xi_control", "tras", "trms33", "refit", "speed"):
            yield f"`{row.case}`", row.method, row.measure, row.target, row.value


@table(" | `rollouts_800` | `rollouts_400` | `rollouts_0` (as many updates, no model)")
def rollouts() -> Rows:
    """Yield 800, 400 and no rollouts with our settings."""
    measures = {
        "plant time to the level [s]": "plant_seconds_to_level",
        "final error [rad]": "steady_state_error",
        "area under the curve": "area_under_curve",
        "return at the end": "final_return",
    }
    for plant in ("xi", "tras"):
        found = [runs(plant, setting) for setting in ROLLOUTS]
        level = [f"{seeds(numbers(own, 'episodes_to_level'))} ({_reached(own)} seeds)" for own in found]
        yield f"`{plant}`, real episodes to the level", *level
        for words, column in measures.items():
            yield f"`{plant}`, {words}", *(seeds(numbers(own, column)) for own in found)


@table("plant, setting | seeds | reached | real episodes to the level | error, worse axis [rad]")
def controls() -> Rows:
    """Yield the controls of the ablation."""
    found = read("ablation.csv")
    found = found[(found.experiment == "dyna") & ~found.setting.str.startswith("sb3")]
    for (plant, name), own in found.groupby(["system", "setting"], sort=False):
        errors, level = worse_axis(plant, name, "dyna", LAST[plant]), seeds(numbers(own, "episodes_to_level"))
        yield f"`{plant}`, `{name}`", len(own), _reached(own), level, seeds(errors)


@table("plant, setting | seeds, episodes | return at the end | area under the curve | error at the end [rad]")
def paper() -> Rows:
    """Yield the paper's experiment at the end of its runs."""
    for plant in ("xi", "tras"):
        for name in ROLLOUTS:
            found = runs(plant, name, "paper")
            columns = ("final_return", "area_under_curve", "steady_state_error")
            measured = (seeds(numbers(found, column)) for column in columns)
            yield f"`{plant}`, `{name}`", f"{len(found)}, {found.episodes.iloc[0]}", *measured


@table("rollouts | after 60 episodes | after 180 | after 300 | after 600")
def paper_errors() -> Rows:
    """Yield the error of the worse axis of each seed of the paper's experiment on `xi` along its 600 episodes."""
    for name in ROLLOUTS:
        cells = (worse_axis("xi", name, "paper", episode) for episode in (60, 180, 300, 600))
        label = "none" if name == "rollouts_0" else name.removeprefix("rollouts_")
        yield label, *(", ".join(short(error, 3) for error in errors) for errors in cells)


def _score(score: Mapping[str, float], metric: str) -> str:
    return pair(score[f"{metric}/{axis}"] for axis in ("alpha_a", "alpha_p"))


def _logged_plants() -> dict[str, dict[str, str]]:
    """Return what is known of each plant of the benchmark of logs."""
    return yaml.safe_load(Path(__file__).with_name("benchmarks").joinpath("logged_plants.yaml").read_text())


def _plants(behind_bench: bool) -> Rows:
    found = read("plants.csv")
    found = found[(found.error_percent != "") & (found.plant.str.endswith("_bench") == behind_bench)]
    for plant, own in found.groupby("plant", sort=False):
        controlled = own[own.verdict == "CONTROLLED"].seed.nunique()
        error, seconds = (numbers(own, column).max() for column in ("error_percent", "plant_seconds"))
        yield f"`{plant}`", f"{controlled} of {own.seed.nunique()}", f"{error:.3g} %", f"{seconds:g} s"


def _percent(found: pd.DataFrame) -> str:
    error = numbers(found, "error_percent").max()
    return f"{error:.3g} %" if error < 100 else "lost"


def _reached(found: pd.DataFrame) -> str:
    return f"{(found.episodes_to_level != '').sum()}/{len(found)}"


if __name__ == "__main__":
    main()
