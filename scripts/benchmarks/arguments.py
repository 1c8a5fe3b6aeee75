"""What the command line of each benchmark takes, apart from its work: help and mistakes cost no import of torch.

Names that a benchmark knows by heavy modules stand here once more, as words; a test holds them equal to the originals.
"""

from __future__ import annotations

import argparse
import ast
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.margins import PLANTS as BEARING
from benchmarks.plants import PLANTS as EXAMPLES

CONTROLLERS = (
    *("planning by gradient", "planning by gradient, integral action"),
    *("LQI, python-control", "NMPC, do-mpc"),
)
MODELS = ("identified", "true")
ROTORS = ("xi", "tras", "trms33")
REPORTED = (
    *("step", "small", "oracle", "moving", "noise", "bench", "bench_delay", "detuned"),
    *("friction", "friction_alone", "unseen", "unseen_moving"),
)
"""Cases of `gradient` that are measured if none is named; the others are trials that were not kept."""
TRIALS = (
    *("moving_long", "moving_long_wide"),
    *("late", "nominal", "detuned_robust"),
)
IDENTIFIED = (
    *(
        "xi_10s",
        "xi_control",
        "xi_noise",
        "van_der_pol",
        "lorenz",
        "standard_errors",
        "tras",
        "trms33",
        "pysindy",
        "refit",
        "speed",
    ),
)
LOGGED = (
    *("servo", "arm", "propeller", "tanks", "oven", "crane", "pole", "drone", "fan", "ship", "beam", "shaft"),
    *("manipulator", "turbine", "drivetrain", "exchanger", "bearing", "cylinder", "neutral", "balanced"),
    *("suspension", "column"),
)
LEARNERS = ("sac_5", "sac", "td3_5", "td3")
RIGS = ("emps", "qube", "tanks")
JOBS = (
    "environment",
    "controller xi",
    "controller tras",
    "imagined replay xi",
    "start-up",
    "imagined replay xi before",
)
SWINGS = ("pendulum_v1", "swing_up", "mountain_car", "double_pendulum", "reacher")
SWINGERS = ("sac", "sac_bullet", "td3")
RESULTS = Path("docs/results")
SEEDS, LOGS, REPEATS = 10, 3, 15
"""What `identify`, `bench_surrogate` and `td3` measure at least before they replace the published figures."""

Options = dict[str, dict[str, Any]]
"""Names of options, with what `argparse` is told of each."""


def _chosen(names: Sequence[str], default: Sequence[str] | None = None) -> dict[str, Any]:
    return {"nargs": "+", "choices": names, "default": list(default or names)}


def _seeds(default: int, told: str | None = None) -> dict[str, Any]:
    return {"type": int, "nargs": "+", "default": list(range(default)), "help": told}


def _appended(name: str, also: str = "") -> Options:
    return {"--out": {"type": Path, "default": RESULTS / f"{name}.csv", "help": f"CSV file to append to{also}"}}


def _replaced(name: str, least: int, of: str) -> Options:
    told = f"CSV file to write; {RESULTS / name}.csv by default, nothing if there are fewer than {least} {of}"
    return {"--out": {"type": Path, "help": told}}


def _checkout(word: str) -> Path:
    """Return a checkout of this project.

    Raises:
        argparse.ArgumentTypeError: It is none.
    """
    folder = Path(word).resolve()
    if not (folder / "scripts" / "train.py").is_file():
        raise argparse.ArgumentTypeError(
            f"{word} has no scripts/train.py; give a folder made by `git worktree add FOLDER COMMIT`"
        )
    return folder


def _episodes(word: str) -> int:
    """Return a number of episodes.

    Raises:
        argparse.ArgumentTypeError: It is below 1.
    """
    if int(word) < 1:
        raise argparse.ArgumentTypeError(f"{word} leaves nothing to evaluate; give 1 or more")
    return int(word)


OPTIONS: dict[str, Options] = {
    "baselines": {
        "--plants": _chosen(("tras", "xi")),
        "--controllers": _chosen(CONTROLLERS),
        "--models": _chosen(MODELS),
        "--seeds": _seeds(5, "seeds of excitation and training"),
        "--seconds": {"type": float, "default": 0.0, "help": "length of every run; 0 takes the scenario's own"},
        **_appended("baselines", "; its table lies beside it"),
    },
    "from_log": {"--seeds": _seeds(10), **_appended("from_log")},
    "gradient": {
        "--cases": _chosen((*REPORTED, *TRIALS), REPORTED),
        "--plants": _chosen(ROTORS),
        "--seeds": _seeds(10, "seeds to measure"),
        **_appended("gradient"),
    },
    "identify": {
        "--seeds": {"type": int, "default": SEEDS, "help": "seeds of each case with seeds"},
        "--only": {"nargs": "*", "choices": IDENTIFIED, "help": "names of cases; all by default"},
        **_replaced("identification", SEEDS, "seeds"),
    },
    "logs": {"--plants": _chosen(LOGGED), "--seeds": _seeds(3), **_appended("logs")},
    "margins": {"--plants": _chosen(BEARING), "--seeds": _seeds(3), **_appended("margins")},
    "model_free": {
        "--plants": _chosen(("xi", "tras")),
        "--agents": _chosen(LEARNERS),
        "--seeds": _seeds(5),
        "--episodes": {"type": _episodes, "default": 20, "help": "real episodes after the excitation"},
        "--out": {"type": Path, "default": Path("runs/model_free"), "help": "folder of the runs"},
        "--results": {"type": Path, "default": RESULTS, "help": "folder of the ablation's tables and figures"},
    },
    "plants": {"--plants": _chosen(tuple(EXAMPLES)), "--seeds": _seeds(5), **_appended("plants")},
    "rig": {
        "--hertz": {"type": float, "nargs": "+", "default": [20.0, 100.0]},
        "--moments": {"type": int, "default": 5, "help": "moments at which each fault is injected"},
        "--seconds": {"type": float, "default": 20.0, "help": "length of the flight without faults"},
        **_appended("rig"),
    },
    "rigs": {
        "--data": {"type": Path, "required": True, "help": "folder of the logs"},
        "--rigs": _chosen(RIGS),
        **_appended("rigs", "; errors over the test logs lie beside it"),
    },
    "speed": {
        "--seeds": _seeds(3, "seeds of the controllers"),
        "--out": {"type": Path, "default": RESULTS / "speed.csv", "help": "CSV file to write"},
        "--jobs": {"nargs": "+", "choices": JOBS, "help": "jobs to measure; the file keeps its rows of the others"},
        "--before": {"type": _checkout, "help": "checkout of an earlier commit, for `imagined replay xi before`"},
    },
    "bench_surrogate": {
        "--logs": {"type": int, "default": LOGS, "help": "logs of each case"},
        **_replaced("standin", LOGS, "logs"),
    },
    "swing_up": {
        "--plants": _chosen(SWINGS, SWINGS[:2]),
        "--agents": _chosen(SWINGERS),
        "--seeds": _seeds(3),
        "--steps": {"type": int, "help": "real steps after which a run ends; a plant's own if omitted"},
        **_appended("swing_up"),
    },
    "td3": {
        "--repeats": {"type": int, "default": REPEATS, "help": "repeats of which the median is taken"},
        **_replaced("td3", REPEATS, "repeats"),
    },
}
"""The options of each benchmark."""


def names() -> list[str]:
    """Return the names of the benchmarks."""
    return sorted(OPTIONS)


def told(name: str) -> str:
    """Return the first paragraph of a benchmark's docstring as one line; the benchmark is not imported."""
    source = (Path(__file__).with_name(f"{name}.py")).read_text()
    return " ".join((ast.get_docstring(ast.parse(source)) or "").partition("\n\n")[0].split())


def parsed(name: str, argv: Sequence[str], program: str = "benchmark.py") -> argparse.Namespace:
    """Return what a command line gives a benchmark; a mistake or `--help` ends the program.

    Args:
        name: Name of the benchmark.
        argv: The words after it.
        program: What its name stands after in the help.
    """
    parser = argparse.ArgumentParser(prog=f"{program} {name}", description=told(name))
    for option, settings in OPTIONS[name].items():
        parser.add_argument(option, **settings)
    return parser.parse_args(argv)
