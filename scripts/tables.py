"""Write the tables of README and docs anew from the files of docs/results: `python scripts/tables.py`.

A page holds `<!-- table: NAME -->` and `<!-- end -->`; what stands between them are the rows of the function of that
name below. A number that changes in a file changes in the pages by this command, and by nothing else. Files of studies
that are finished change no more, and need no function.
"""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd
import yaml

from dynasindy.safe_io import write_text

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
BLOCK = re.compile(r"(<!-- table: (\w+) -->\n\n).*?(\n\n<!-- end -->)", re.S)
Rows = Iterator[Sequence[object]]
"""The heading of a table, and its rows."""


def markdown(name: str) -> str:
    """Return a table by its name."""
    heading, *lines = TABLES[name]()
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in (heading, ["---"] * len(heading), *lines))


def pages() -> dict[Path, str]:
    """Return the pages, with each table as the files have it now."""
    files = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *RESULTS.glob("*.md")]
    texts = ((file, file.read_text(encoding="utf-8")) for file in files)
    return {file: BLOCK.sub(lambda block: block[1] + markdown(block[2]) + block[3], text) for file, text in texts}


def main() -> None:
    """Write every page whose tables differ from the files."""
    for file, text in pages().items():
        if file.read_text(encoding="utf-8") != text:
            write_text(file, text)
            print(file.relative_to(ROOT))


def rows(name: str, **wanted: str) -> pd.DataFrame:
    """Return the rows of a CSV file of docs/results that have the wanted cells, each cell as text."""
    found = pd.read_csv(RESULTS / name, dtype=str, keep_default_na=False)
    return found[(found[[*wanted]] == [*wanted.values()]).all(axis=1)]


def worst(found: pd.DataFrame, column: str) -> float:
    """Return the largest number of a column, of which an empty cell is infinite."""
    return float(found[column].replace("", "inf").astype(float).max())


def axes(found: pd.DataFrame) -> str:
    """Return the errors [rad] of the worst seed on each axis in mrad: 0.6 / 1.1."""
    values = [1000 * worst(found, axis) for axis in ("azimuth", "pitch")]
    return " / ".join(f"{value:.1f}" if value >= 0.095 else f"{value:.1g}" for value in values)


def main_job() -> Rows:
    yield "plant", "data", "error, azimuth / pitch [mrad]", "CPU time"
    for plant in ("tras", "xi"):
        found = rows("gradient.csv", case="step", plant=plant, plant_seconds="10.0")
        yield f"`{plant}`", "10 s", axes(found), f"{worst(found, 'cpu_seconds'):.0f} s"


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


def gradient() -> Rows:
    """Yield the worst of ten seeds in each case of planning by gradient, after 10 s of data."""
    yield "case", "`tras`", "`xi`", "CPU time"
    for (case, scenario), words in CASE_WORDS.items():
        found = rows("gradient.csv", case=case, scenario=scenario, plant_seconds="10.0")
        own = {plant: axes(of) for plant, of in found.groupby("plant")}
        cpu = f"{worst(found, 'cpu_seconds'):.0f} s"
        yield f"{words} (`{case}`)", own.get("tras") or own.get("trms33"), own.get("xi", ""), cpu


MODELS = ("ours", "ours with structure", "ARX", "subspace", "pysindy", "last value held")
"""Models of every rig."""
SHOWN = {
    **{"tanks": "test simulated", "emps": "test simulated", "qube": "both angles 0.2 s ahead"},
    **{"silverbox": "test simulated", "ball_beam": "position 2 s ahead", "quarter_drone": "angle 1 s ahead"},
    **{"tclab": "both temperatures 300 s ahead", "tras_unnamed": "azimuth 2 s ahead"},
    "tras_harder": "azimuth 2 s ahead",
}
"""The error of each rig that the pages show; the file has all of them."""


def rig_models() -> Rows:
    """Yield the newest errors of models of logged plants on their test logs."""
    yield "rig", "RMSE", *(name.replace("pysindy", "PySINDy") for name in MODELS), "another"
    for rig, metric in SHOWN.items():
        own = rows("rigs.csv", rig=rig, metric=f"{metric}, RMSE").drop_duplicates("model", keep="last")
        cells = dict(zip(own.model, own.value, strict=True))
        others = (name for name in ("ARX with a cubic", "inverse dynamics", "second-order linear") if name in cells)
        another = ", ".join(f"{name} {cells[name]}" for name in others)
        yield rig, f"{metric} [{own.unit.iloc[0]}]", *(cells.get(name, "") for name in MODELS), another


def plants() -> Rows:
    yield "plant", "held to 1 %", "error of the worst seed", "data"
    found = rows("plants.csv").query("error_percent != ''")
    for plant, own in sorted(found.groupby("plant", sort=False), key=lambda pair: pair[0].endswith("_bench")):
        held = own[own.verdict == "CONTROLLED"].seed.nunique()
        error, seconds = worst(own, "error_percent"), worst(own, "plant_seconds")
        yield f"`{plant}`", f"{held} of {own.seed.nunique()}", f"{error:.3g} %", f"{seconds:g} s"


def logs() -> Rows:
    yield "plant, what is measured", "promised", "held to 1 %", "error of the worst seed", "error of the first run"
    titles = yaml.safe_load((Path(__file__).with_name("benchmarks") / "logged_plants.yaml").read_text())
    newest, first = rows("logs.csv"), rows("logs_first.csv")
    for plant, facts in titles.items():
        own = newest[newest.plant == plant]
        of, promised = own.seed.nunique(), own[own.foretold == "CONTROLLED"].seed.nunique()
        held = of - own[own.error_percent.astype(float) > 1].seed.nunique()
        errors = (worst(found, "error_percent") for found in (own, first[first.plant == plant]))
        shown = ("" if pd.isna(error) else f"{error:.3g} %" if error < 100 else "lost" for error in errors)
        yield facts["title"], f"{promised} of {of}", f"{held} of {of}", *shown


def peers() -> Rows:
    yield "plant", "model", "error on the test log, simulated", "CPU time"
    for row in rows("peers.csv", case="model, test log simulated").itertuples():
        unit = row.measure.removeprefix("RMSE, ")
        yield f"`{row.plant}`", f"{row.peer} {row.version}", f"{row.value} {unit}", f"{row.cpu_seconds} s"


def identification() -> Rows:
    """Yield what identification had to reach from exact data, and what was measured."""
    yield "case", "by", "what is measured", "must reach", "value"
    for row in rows("identification.csv").itertuples():
        if row.case in ("xi_10s", "xi_control", "tras", "trms33", "refit", "speed") and row.value.count(",") < 2:
            yield f"`{row.case}`", row.method, row.measure, row.target, row.value


TABLES = {table.__name__: table for table in (main_job, gradient, rig_models, plants, logs, peers, identification)}
"""The tables by name."""


if __name__ == "__main__":
    main()
