"""Write the tables of README and docs anew from the files of docs/results: `python scripts/tables.py`.

A page holds `<!-- table: NAME -->` and `<!-- end -->`; what stands between them is what the function of that name below
returns. A number that changes in a file changes in the pages by this command, and by nothing else.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path

import torch

from dynasindy.evaluation.ablation import Level, read_ablation, to_markdown
from dynasindy.evaluation.statistics import interquartile_mean, over_seeds
from dynasindy.safe_io import write_text

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
BLOCK = re.compile(r"(<!-- table: (\w+) -->\n\n).*?(\n\n<!-- end -->)", re.S)
Row = Mapping[str, str]
AXES, WORST = ("azimuth", "pitch"), ("azimuth_worst", "pitch_worst")
ERRORS = ("steady_state_error/alpha_a", "steady_state_error/alpha_p")
ROLLOUTS = ("rollouts_800", "rollouts_400", "rollouts_0")
LAST = {"xi": 12, "tras": 16}
"""Episodes after which the controls of the ablation are compared."""


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
def rows_of(name: str) -> tuple[dict[str, str], ...]:
    """Return the rows of a CSV file of docs/results."""
    with (RESULTS / name).open(newline="", encoding="utf-8") as file:
        return tuple(csv.DictReader(file))


def rows(name: str, **wanted: object) -> list[dict[str, str]]:
    """Return the rows that have the wanted cells; there is at least one."""
    found = [row for row in rows_of(name) if all(row[key] == str(value) for key, value in wanted.items())]
    if not found:
        raise ValueError(f"{name} has no row with {wanted}")
    return found


def numbers(found: Iterable[Row], column: str) -> list[float]:
    """Return a column, an empty cell as infinite."""
    return [float(row[column] or "inf") for row in found]


def grid(header: str, lines: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table; `header` is its first line without the outer bars."""
    columns = header.split(" | ")
    cells = [columns, ["---"] * len(columns), *lines]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in cells)


def short(value: float, places: int = 4) -> str:
    """Return a number without the zero before its point: .0006; of 1 and above three digits."""
    return f"{value:.{places}f}".removeprefix("0") if value < 1 else f"{value:.2f}"


def pair(of: Callable[[str], float], places: int = 4, axes: Sequence[str] = AXES) -> str:
    """Return azimuth and pitch: .0006 / .0011."""
    return " / ".join(short(of(axis), places) for axis in axes)


def worst(found: Sequence[Row], axes: Sequence[str] = AXES) -> str:
    """Return the worst seed on each axis."""
    return pair(lambda axis: max(numbers(found, axis)), axes=axes)


def seeds(values: Sequence[float]) -> str:
    """Return the interquartile mean over seeds and its interval."""
    return over_seeds(values, 4, "never").replace("never [never, never]", "never")


def runs(plant: str, setting: str, experiment: str = "dyna") -> list[dict[str, str]]:
    """Return the rows of a setting of the ablation, one per seed."""
    return rows("ablation.csv", system=plant, experiment=experiment, setting=setting)


def main_job() -> str:
    """Return the errors of the main job after 10 s of data, of the worst of ten seeds."""
    found = {plant: _gradient("step", plant) for plant in ("tras", "xi")}
    return grid(
        "plant | data | error, azimuth / pitch | time on one core",
        [
            (f"`{plant}`", "10 s", f"{worst(own)} rad", f"{max(numbers(own, 'cpu_seconds')):.0f} s")
            for plant, own in found.items()
        ],
    )


def policies() -> str:
    """Return the scores of the controllers that lie in the repository."""
    lines = []
    for plant in ("tras", "xi"):
        file = RESULTS / "policies" / plant / "origin.json"
        score = json.loads(file.read_text())["evaluation"]
        errors = (_score(score, metric) for metric in ("steady_state_error", "rmse"))
        lines.append((f"[`{plant}`]({file.relative_to(ROOT)})", "30 s", *errors))
    return grid("policy | data | error, azimuth / pitch [rad] | RMSE, azimuth / pitch [rad]", lines)


def scenarios() -> str:
    """Return what the policy of the main job makes of each scenario."""
    lines = []
    for name in ("step", "sine", "square", "wind", "noise", "delay", "detuned"):
        score = json.loads((RESULTS / f"runs/tras_gradient/evaluation/{name}.json").read_text())
        errors = (_score(score, metric) for metric in ("rmse", "steady_state_error"))
        lines.append((f"`{name}`", *errors, f"{score['return']:.1f}"))
    return grid("scenario | RMSE [rad] | mean abs error of the last 5 s [rad] | return", lines)


def gradient() -> str:
    """Return the worst seed of each case of planning by gradient."""
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
    both = ("tras", "xi")
    cases = [(case, "", p, s) for case in ("step", "nominal") for p in both for s in (10, 30)]
    cases += [("small", "", p, 10) for p in both]
    cases += [("moving", wave, p, 10) for p in both for wave in ("sine", "square")]
    integral = ("", "step_integral")
    cases += [("noise", action, p, s) for p in both for s in (10, 30, 70) for action in integral]
    cases += [(case, "", p, 10) for case in ("bench", "bench_delay") for p in both]
    cases += [("detuned", scenario, "tras", 10) for scenario in ("detuned_gust", "detuned_gust_integral")]
    cases += [("friction_alone", action, "trms33", 10) for action in integral]
    cases += [("oracle", "", p, 10) for p in both]
    lines = []
    for case, scenario, plant, seconds in cases:
        found = _gradient(case, plant, seconds, scenario or "step")
        words = f"`{case}`" + (f", {scenario}, RMSE" if case == "moving" else "")
        words += ", integral action" if scenario.endswith("integral") else ""
        errors = worst(found)
        errors += f" ({worst(found, WORST)})" if case in ("detuned", "friction_alone") else ""
        target = reach.get((scenario if case == "moving" else case, plant, seconds), "")
        cpu = f"{max(numbers(found, 'cpu_seconds')):.0f}"
        lines.append((words, f"`{plant}`", f"{seconds} s", len(found), errors, cpu, target))
    return grid("case | plant | real data | seeds | worst seed | CPU [s] | to reach", lines)


def unseen() -> str:
    """Return the situations that nothing was tuned on."""
    policy = {"unseen": "step", "unseen_moving": "moving"}
    lines = []
    for case, scenario, plant in dict.fromkeys((r["case"], r["scenario"], r["plant"]) for r in rows_of("gradient.csv")):
        if case in policy:
            found = _gradient(case, plant, scenario=scenario)
            middle = pair({axis: _middle(numbers(found, axis)) for axis in AXES}.__getitem__)
            who = (f"`{scenario}`", f"`{policy[case]}`", f"`{plant}`", len(found))
            lines.append((*who, middle, worst(found), worst(found, WORST)))
    return grid("situation | policy of | plant | seeds | error | worst seed | worst single reference", lines)


def rigs() -> str:
    """Return the scores of models of real plants."""
    lines = [(r["rig"], r["model"], f"{r['metric']} [{r['unit']}]", r["value"]) for r in rows_of("rigs.csv")]
    return grid("rig | model | error | value", lines)


def plants() -> str:
    """Return the plants that were given as equations."""
    return _plants(
        {
            "van_der_pol": "Van der Pol's oscillator",
            "quadrotor": "quadrotor in a plane (x, z)",
            "tanks": "two tanks, sampled every 2 s",
            "cart_pole": "cart and pole (position, upright)",
            "swing_up": "the same pole, swung up from hanging",
            "pendulum_v1": "Gymnasium's Pendulum-v1, swung up",
            "mountain_car": "MountainCarContinuous-v0, to the flag",
            "inverted_pendulum": "MuJoCo's InvertedPendulum-v5, at a place",
            "double_pendulum": "MuJoCo's InvertedDoublePendulum-v5, at a place",
            "reacher": "MuJoCo's Reacher-v5, to a point",
        }
    )


def bench_plants() -> str:
    """Return the plants behind the sensors of a bench."""
    return _plants(
        {
            "furuta_bench": "rotary pendulum (angle of its arm, upright)",
            "balancer_bench": "robot on two wheels (place, upright)",
            "cart_pole_bench": "cart and pole, behind encoders",
            "ball_on_beam_bench": "ball on a beam, behind steps of a place and an angle",
            "quadrotor_bench": "quadrotor in a plane, behind cameras",
        }
    )


def logs() -> str:
    """Return the plants that are known by a log alone."""
    names = {
        "servo": "motor with dry friction, encoder",
        "arm": "arm on a motor, encoder",
        "propeller": "arm moved by a propeller, encoder",
        "tanks": "two tanks, noisy levels, every second",
        "oven": "oven, steps of a tenth of a degree",
        "crane": "crane (place, sway), encoders",
        "pole": "pole on a cart, encoders, closed loop",
        "drone": "height of a drone, noisy range, closed loop",
        "fan": "speed of a fan, noisy tachometer",
        "ship": "heading of a ship, steps of a tenth of a degree",
        "beam": "ball on a beam, noisy place, closed loop",
        "shaft": "two discs on a soft shaft, encoders",
    }
    lines = []
    for plant, name in names.items():
        found = rows("logs.csv", plant=plant)
        every = {row["seed"] for row in found}
        promised = {row["seed"] for row in found if row["foretold"] == "CONTROLLED"}
        missed = {row["seed"] for row in found if float(row["error_percent"]) > 1}
        counts = f"{len(promised)} of {len(every)}", f"{len(every - missed)} of {len(every)}"
        lines.append((name, *counts, _percent(found)))
    return grid("plant, what is measured | promised | held to 1 % | error of the worst seed", lines)


def textbook_logs() -> str:
    """Return the plants out of textbooks, at first and since."""
    names = {
        "manipulator": "arm of two links, encoders",
        "turbine": "speed of a wind turbine, by its pitch",
        "drivetrain": "motor on a soft shaft, encoder of the motor",
        "exchanger": "heat exchanger, a pipe to the sensor",
        "bearing": "magnetic bearing, closed loop",
        "cylinder": "hydraulic cylinder, a valve's square root",
        "neutral": "pH of a neutralisation",
        "balanced": "pole on a cart in degrees and volts, closed loop",
        "suspension": "active suspension of a quarter of a car",
        "column": "distillation column, two inputs with delays",
    }
    words = {"CONTROLLED": "promised", "NOT promised": "not promised", "no controller": "no controller"}
    lines = []
    for plant, name in names.items():
        line = [name]
        for file in ("logs_first.csv", "logs.csv"):
            found = [row for row in rows_of(file) if row["plant"] == plant and row["seed"] == "0"]
            ended = "not ended" if (file, plant) == ("logs.csv", "cylinder") else "not run"
            line += [words[found[0]["foretold"]], _percent(found)] if found else [ended, "none"]
        lines.append(line)
    return grid("plant, what is measured | at first | error at first | since | error since", lines)


def peers() -> str:
    """Return ours beside the strongest peers: errors of controllers, the worst target in brackets, and of models."""
    groups: dict[tuple[str, ...], list[dict[str, str]]] = {}
    for row in rows("peers.csv"):
        key = tuple(row[name] for name in ("case", "plant", "peer", "version", "cpu_seconds", "ms_per_action"))
        groups.setdefault(key, []).append(row)
    lines = []
    for (case, plant, peer, version, seconds, milliseconds), found in groups.items():
        values = [row["value"] for row in found]
        if len(values) == 4:
            words = "{} / {} ({} / {}) rad".format(*values)
        else:
            words = f"{values[0]} {found[0]['measure'].removeprefix('RMSE, ')}"
        name = "ours" if peer == "ours" else f"{peer} {version}"
        lines.append((case, f"`{plant}`", name, words, seconds, milliseconds))
    return grid("case | plant | by | error | CPU [s] | ms per action", lines)


def identification() -> str:
    """Return what identification had to reach, and what was measured."""
    exact, worst_error = "seeds with 19 of 19 terms and 0 false", "worst relative coefficient error"
    ratio = f"{float(_identified('trms33', 'worst state', 'ours, rotor', exactly=True)):g}"
    xi, tras = (
        _identified("speed", f"{plant} model").partition(",")[0].replace("e+0", "e") for plant in ("xi", "tras")
    )
    theirs = float(_identified("speed", "xi", "PySINDy"))
    refits = [float(_identified("refit", size)) for size in ("1e+06", "1e+07")]
    errors = {case: _identified(case, worst_error).replace("e-0", "e-") for case in ("xi_10s", "xi_control")}
    exactly = {case: _identified(case, exact) for case in errors}
    speeds = f"{xi} (`xi`), {tras} (`tras`); PySINDy `simulate` {theirs:.0f}"
    best, reaction = (
        _identified(*one) for one in (("tras", "worst state"), ("trms33", "worst state", "ours, rotor_r"))
    )
    slow = _identified("refit", "fit of 1e6", "PySINDy")
    lines = [
        ("`xi`, 10 s at 0.01 s, 10 seeds", "19 of 19 terms, 0 false, error <= 1e-6", "xi_10s"),
        ("`xi`, 20 s at 0.05 s, 10 seeds", "19/0, <= 1e-4", "xi_control"),
        ("`tras`, 20 s, rotor library", "400-step NRMSE <= 2 %", f"{best} % worst state, 32 unseen episodes"),
        ("`trms33`, `rotor_reaction`", "the best honest figure", f"{reaction} % worst state over 26 unseen episodes"),
        ("`trms33`, `rotor`", "the best honest figure", f"{ratio} % worst state over 26 unseen episodes"),
        ("refit after 20 s on top of 1e6 samples", "<= 10 ms", f"{refits[0]:.2g} ms; PySINDy {slow} ms"),
        ("the same on top of 1e7 samples", "at most twice that", f"{refits[1]:.2g} ms"),
        ("refined fit of 1000 samples", "<= 1 s", f"{float(_identified('xi_10s', 'refined fit')):.2f} s"),
        ("imagined transitions per second, batch 4096", ">= 1e6", speeds),
    ]
    named = {case: f"{exactly[case]}, worst {errors[case]}" for case in errors}
    return grid("case | must reach | measured", [(*line[:2], named.get(line[2], line[2])) for line in lines])


def rollouts() -> str:
    """Return 800, 400 and no rollouts with our settings."""
    measures = {
        "plant time to the level [s]": "plant_seconds_to_level",
        "final error [rad]": "steady_state_error",
        "area under the curve": "area_under_curve",
        "return at the end": "final_return",
    }
    lines = []
    for plant in ("xi", "tras"):
        found = [runs(plant, setting) for setting in ROLLOUTS]
        level = [f"{seeds(numbers(own, 'episodes_to_level'))} ({_reached(own)} seeds)" for own in found]
        lines.append((f"`{plant}`, real episodes to the level", *level))
        for words, column in measures.items():
            lines.append((f"`{plant}`, {words}", *(seeds(numbers(own, column)) for own in found)))
    return grid(" | `rollouts_800` | `rollouts_400` | `rollouts_0` (as many updates, no model)", lines)


def controls() -> str:
    """Return the controls of the ablation."""
    names = ["rollouts_800", "oracle", "pysindy", "pysindy_gate_off", "direct", "rollouts_0_tuned"]
    names += [f"real_share_{share}" for share in ("05", "25", "50")]
    names += [f"horizon_{length}" for length in (1, 5, 20, 100, 400)]
    lines = []
    for plant, chosen in (("xi", names), ("tras", ["rollouts_800", "oracle", "rollouts_0_tuned", *names[-3:-1]])):
        for name in chosen:
            found = runs(plant, name)
            curves = rows("ablation_curves.csv", system=plant, experiment="dyna", setting=name, episode=LAST[plant])
            level = seeds(numbers(found, "episodes_to_level"))
            errors = seeds([max(float(row[f"evaluated_{column}"]) for column in ERRORS) for row in curves])
            lines.append((f"`{plant}`, `{name}`", len(found), _reached(found), level, errors))
    return grid("plant, setting | seeds | reached | real episodes to the level | error, worse axis [rad]", lines)


def paper() -> str:
    """Return the paper's experiment at the end of its runs."""
    columns = ("final_return", "area_under_curve", "steady_state_error")
    lines = []
    for plant in ("xi", "tras"):
        for name in ROLLOUTS:
            found = runs(plant, name, "paper")
            measured = (seeds(numbers(found, column)) for column in columns)
            lines.append((f"`{plant}`, `{name}`", f"{len(found)}, {found[0]['episodes']}", *measured))
    header = "plant, setting | seeds, episodes | return at the end | area under the curve | error at the end [rad]"
    return grid(header, lines)


def paper_errors() -> str:
    """Return the error of the worse axis of each seed of the paper's experiment on `xi` along its 600 episodes."""
    lines = []
    for name in ROLLOUTS:
        cells = []
        for episode in (60, 180, 300, 600):
            found = rows("ablation_curves.csv", system="xi", experiment="paper", setting=name, episode=episode)
            worse = [max(float(row[f"evaluated_{column}"]) for column in ERRORS) for row in found]
            cells.append(", ".join(short(error, 3) for error in worse))
        lines.append(("none" if name == "rollouts_0" else name.removeprefix("rollouts_"), *cells))
    return grid("rollouts | after 60 episodes | after 180 | after 300 | after 600", lines)


def _gradient(case: str, plant: str, seconds: float = 10.0, scenario: str = "step") -> list[dict[str, str]]:
    return rows("gradient.csv", case=case, plant=plant, plant_seconds=float(seconds), scenario=scenario)


def _score(score: Mapping[str, float], metric: str) -> str:
    return pair(lambda axis: score[f"{metric}/{axis}"], axes=("alpha_a", "alpha_p"))


def _plants(names: Mapping[str, str]) -> str:
    lines = []
    for plant, name in names.items():
        found = rows("plants.csv", plant=plant)
        held, every = ({r["seed"] for r in found if r["verdict"] == "CONTROLLED"}, {r["seed"] for r in found})
        seconds = f"{max(numbers(found, 'plant_seconds')):.0f} s"
        lines.append((name, f"{len(held)} of {len(every)}", f"{max(numbers(found, 'error_percent')):.3g} %", seconds))
    return grid("plant | held to 1 % | error of the worst seed | data", lines)


def _percent(found: Sequence[Row]) -> str:
    error = max(numbers(found, "error_percent"))
    return f"{error:.3g} %" if error < 100 else "lost"


def _identified(case: str, words: str, method: str = "ours", exactly: bool = False) -> str:
    """Return a cell of identification.csv by its case, the beginning of its method, and words of its measure."""
    return next(
        row["value"]
        for row in rows("identification.csv", case=case)
        if words in row["measure"] and (row["method"] == method if exactly else row["method"].startswith(method))
    )


def _reached(found: Sequence[Row]) -> str:
    return f"{sum(bool(row['episodes_to_level']) for row in found)}/{len(found)}"


def _middle(values: Sequence[float]) -> float:
    return interquartile_mean(torch.tensor(values, dtype=torch.float64)).item()


TABLES: dict[str, Callable[[], str]] = {
    one.__name__: one
    for one in (
        *(main_job, policies, scenarios, gradient, unseen, rigs, plants, bench_plants, logs, textbook_logs),
        *(identification, rollouts, controls, paper, paper_errors, peers),
    )
}
"""The tables by name."""

if __name__ == "__main__":
    main()
