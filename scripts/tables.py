"""Write the tables of README and docs anew from the files of docs/results: `python scripts/tables.py`.

A page holds `<!-- table: NAME -->` and `<!-- end -->`; what stands between them are the rows of the function of that
name below. A number that changes in a file changes in the pages by this command, and by nothing else. Files of studies
that are finished change no more, and need no function.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path

import pandas as pd
import yaml

from dynasindy.evaluation.ablation import Level, read_ablation, to_markdown
from dynasindy.evaluation.statistics import over_seeds
from dynasindy.safe_io import write_text

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
BLOCK = re.compile(r"(<!-- table: (\w+) -->\n\n).*?(\n\n<!-- end -->)", re.S)
AXES = ["azimuth", "pitch"]
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


def mrad(value: float) -> str:
    """Return an angle [rad] in mrad: 0.6."""
    return f"{1000 * value:.1f}" if value >= 9.5e-5 else f"{1000 * value:.1g}" if value >= 5e-7 else "< 0.001"


def pair(values: Iterable[float]) -> str:
    """Return azimuth and pitch [rad] in mrad: 0.6 / 1.1."""
    return " / ".join(map(mrad, values))


def axes(found: pd.DataFrame, over: str = "max") -> str:
    """Return the worst seed on each axis, or the mean over seeds."""
    return pair(found[AXES].astype(float).agg(over))


def score(file: str, metric: str) -> str:
    """Return a metric on each axis of an evaluation that was kept."""
    found = json.loads((RESULTS / file).read_text())
    return pair(found.get("evaluation", found)[f"{metric}/{axis}"] for axis in ("alpha_a", "alpha_p"))


def runs(plant: str, setting: str) -> pd.DataFrame:
    """Return the rows of a setting of the ablation, one per seed."""
    return rows("ablation.csv", system=plant, experiment="dyna", setting=setting)


@table("plant | data | error, azimuth / pitch [mrad] | CPU time")
def main_job() -> Rows:
    for plant in ("tras", "xi"):
        found = rows("gradient.csv", case="step", plant=plant, plant_seconds=10.0)
        yield f"`{plant}`", "10 s", axes(found), f"{numbers(found, 'cpu_seconds').max():.0f} s"


NEEDS = {
    "planning by gradient": ("this policy", "ranges of inputs and targets"),
    "planning by gradient, integral action": ("this policy, with integral action", "the same"),
    "LQI": ("LQI", "six weights, here by a search on the model"),
    "MPC": ("nonlinear MPC, Gauss-Newton", "weights, horizon"),
    "PID": ("two PID loops", "six gains, here by a search on the model"),
    "do-mpc NMPC": ("nonlinear MPC, do-mpc (2 targets)", "weights, horizon, smooth magnitudes, a hint of rotor speeds"),
    "do-mpc ApproxMPC": ("a network that imitates it, do-mpc", "the same, and where to sample"),
    "NeuroMANCER as documented": ("NeuroMANCER, as documented", "loss, horizon, network, learning rate"),
    "NeuroMANCER helped": ("NeuroMANCER, with this project's cost", "the same, and windows and a schedule"),
    "sb3_sac_5": ("SAC, Stable-Baselines3, no model", "the reward"),
    "sb3_td3_5": ("TD3, Stable-Baselines3, no model", "the reward"),
}
"""What controllers are called, and what each has to be told."""


@table(
    "controller | data | error, azimuth / pitch [mrad] | CPU time to make it | time per action | what it has to be told"
)
def controllers() -> Rows:
    """Yield controllers of `tras` beside the policy, whose times are 1."""
    step = read("baselines.csv").query("plant == 'tras' and model == 'identified' and scenario == 'step'")
    pace = step.assign(ms=numbers(step, "ms_per_action")).groupby("controller").ms.mean()
    for name, (who, needs) in NEEDS.items():
        if name.startswith("sb3"):
            found = runs("tras", name)
            seconds = numbers(rows("ablation_curves.csv", system="tras", setting=name), "plant_seconds").max()
            error = pair(numbers(found, f"steady_state_error/{axis}").mean() for axis in ("alpha_a", "alpha_p"))
            yield who, f"{seconds:.0f} s", error, "", "", needs
        elif name in pace:
            error = axes(step.query("controller == @name and metric == 'steady_state_error'"), "mean")
            made = "1" if name.startswith("planning") else ""
            yield who, "10 s", error, made, f"{pace[name] / pace['planning by gradient']:.2g}", needs
        else:
            own = rows("peers.csv", peer=name)
            beside = rows("peers.csv", peer="ours", case=own.case.iloc[0], commit=own.commit.iloc[0])
            times = (numbers(own, key).max() / numbers(beside, key).max() for key in ("cpu_seconds", "ms_per_action"))
            yield who, "10 s", pair(numbers(own, "value")[:2]), *(f"{share:.2g}" for share in times), needs


@table("policy | data | error, azimuth / pitch [mrad] | RMSE, azimuth / pitch [mrad]")
def policies() -> Rows:
    for plant in ("tras", "xi"):
        file = f"policies/{plant}/origin.json"
        yield f"[`{plant}`]({file})", "30 s", score(file, "steady_state_error"), score(file, "rmse")


@table("scenario | RMSE [mrad] | error at the end [mrad] | return")
def scenarios() -> Rows:
    for name in ("step", "sine", "square", "wind", "noise", "delay", "detuned"):
        file = f"runs/tras_gradient/evaluation/{name}.json"
        earned = json.loads((RESULTS / file).read_text())["return"]
        yield f"`{name}`", score(file, "rmse"), score(file, "steady_state_error"), f"{earned:.1f}"


CASE_WORDS = {
    ("step", "step"): "all states measured",
    ("small", "step"): "the same, a network of 2 x 64 units",
    ("oracle", "step"): "the same, planned on the plant itself",
    ("moving", "sine"): "sine, one policy for steps and waves (RMSE)",
    ("moving", "square"): "square wave, the same policy (RMSE)",
    ("noise", "step"): "noisy sensors, state observer",
    ("noise", "step_integral"): "the same, with integral action",
    ("bench", "step"): "encoders and noisy tachometers, no rates measured",
    ("bench_delay", "step"): "the same, inputs a control period late",
    ("detuned", "detuned_gust"): "constants off by up to 10 %, and a gust",
    ("detuned", "detuned_gust_integral"): "the same, with integral action",
    ("friction_alone", "step"): "`trms33`: dry friction in both bearings",
    ("friction_alone", "step_integral"): "the same, with integral action",
}
"""Cases of planning by gradient that the pages show, in words."""


@table("case | `tras` | `xi` | CPU time")
def gradient() -> Rows:
    """Yield the worst of ten seeds in each case of planning by gradient, after 10 s of data."""
    for (case, scenario), words in CASE_WORDS.items():
        found = rows("gradient.csv", case=case, scenario=scenario, plant_seconds=10.0)
        own = {plant: axes(of) for plant, of in found.groupby("plant")}
        cpu = f"{numbers(found, 'cpu_seconds').max():.0f} s"
        yield f"{words} (`{case}`)", own.get("tras") or own.get("trms33"), own.get("xi", ""), cpu


MODELS = {
    **{"ours": "ours", "ours with structure": "with structure", "ARX": "ARX", "subspace": "subspace"},
    **{"pysindy": "PySINDy", "last value held": "last value held"},
}
"""Models of every rig, and what they are called in the table."""
SHOWN = {
    **{"tanks": "test simulated, RMSE", "emps": "test simulated, RMSE", "qube": "both angles 0.2 s ahead, RMSE"},
    **{"silverbox": "test simulated, RMSE", "ball_beam": "position 2 s ahead, RMSE"},
    **{"quarter_drone": "angle 1 s ahead, RMSE", "tclab": "both temperatures 300 s ahead, RMSE"},
    **{"tras_unnamed": "azimuth 2 s ahead, RMSE", "tras_harder": "azimuth 2 s ahead, RMSE"},
}
"""The error of each rig that the pages show; the file has all of them."""


@table(f"rig | error | {' | '.join(MODELS.values())} | another")
def rig_models() -> Rows:
    """Yield the newest errors of models of logged plants on their test logs."""
    for rig, metric in SHOWN.items():
        own = rows("rigs.csv", rig=rig, metric=metric).drop_duplicates("model", keep="last")
        cells = dict(zip(own.model, own.value, strict=True))
        others = (name for name in ("ARX with a cubic", "inverse dynamics", "second-order linear") if name in cells)
        another = ", ".join(f"{name} {cells[name]}" for name in others)
        yield rig, f"{metric} [{own.unit.iloc[0]}]", *(cells.get(name, "") for name in MODELS), another


@table("plant | held to 1 % | error of the worst seed | data")
def plants() -> Rows:
    found = read("plants.csv")
    found = found[found.error_percent != ""]
    for plant, own in sorted(found.groupby("plant", sort=False), key=lambda pair: pair[0].endswith("_bench")):
        controlled = own[own.verdict == "CONTROLLED"].seed.nunique()
        error, seconds = (numbers(own, column).max() for column in ("error_percent", "plant_seconds"))
        yield f"`{plant}`", f"{controlled} of {own.seed.nunique()}", f"{error:.3g} %", f"{seconds:g} s"


@table("plant, what is measured | promised | held to 1 % | error of the worst seed | error of the first run")
def logs() -> Rows:
    titles = yaml.safe_load((Path(__file__).with_name("benchmarks") / "logged_plants.yaml").read_text())
    for plant, facts in titles.items():
        found, first = (of[of.plant == plant] for of in map(read, ("logs.csv", "logs_first.csv")))
        of = found.seed.nunique()
        promised = found[found.foretold == "CONTROLLED"].seed.nunique()
        missed = found[numbers(found, "error_percent") > 1].seed.nunique()
        errors = [numbers(own, "error_percent").max() for own in (found, first)]
        worst = ["" if math.isnan(error) else f"{error:.3g} %" if error < 100 else "lost" for error in errors]
        yield facts["title"], f"{promised} of {of}", f"{of - missed} of {of}", *worst


@table("plant | model | error on the test log, simulated | CPU time")
def peers() -> Rows:
    for row in rows("peers.csv", case="model, test log simulated").itertuples():
        unit = row.measure.removeprefix("RMSE, ")
        yield f"`{row.plant}`", f"{row.peer} {row.version}", f"{row.value} {unit}", f"{row.cpu_seconds} s"


@table("case | by | what is measured | must reach | value")
def identification() -> Rows:
    """Yield what identification had to reach from exact data, and what was measured."""
    for row in read("identification.csv").itertuples():
        if row.case in ("xi_10s", "xi_control", "tras", "trms33", "refit", "speed") and row.value.count(",") < 2:
            yield f"`{row.case}`", row.method, row.measure, row.target, row.value


@table(" | `rollouts_800` | `rollouts_400` | `rollouts_0` (as many updates, no model)")
def rollouts() -> Rows:
    """Yield 800, 400 and no rollouts with our settings: the interquartile mean over seeds and its interval."""
    measures = {
        "real episodes to the level": "episodes_to_level",
        "plant time to the level [s]": "plant_seconds_to_level",
        "final error [rad]": "steady_state_error",
        "area under the curve": "area_under_curve",
        "return at the end": "final_return",
    }
    for plant in ("xi", "tras"):
        settings = [runs(plant, f"rollouts_{number}") for number in (800, 400, 0)]
        for words, column in measures.items():
            means = [over_seeds([*numbers(own, column)], 3, "never") for own in settings]
            cells = [mean.replace("never [never, never]", "never") for mean in means]
            if column == "episodes_to_level":
                seeds = [f"({(own.episodes_to_level != '').sum()}/{len(own)} seeds)" for own in settings]
                cells = [f"{cell} {reached}" for cell, reached in zip(cells, seeds, strict=True)]
            yield f"`{plant}`, {words}", *cells


if __name__ == "__main__":
    main()
