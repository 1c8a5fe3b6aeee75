"""README.md, docs/identification.md and the words of docs/results/baselines.md."""

from collections.abc import Iterator

from benchmarks import logged
from benchmarks.certainty import LASTS
from results_page import limit_cycle
from tables import cell, middle, numbers, pair, record, rows, setting, short, table
from ties import Tie, Untied

from dynasindy.evaluation.fitted import BETTER
from dynasindy.sindy.lag_states import TIMES
from dynasindy.sindy.trajectory_fit import WORSE

README, IDENTIFICATION, BASELINES = "README.md", "docs/identification.md", "docs/results/baselines.md"
SPEED = "docs/speed.md"


def readme(text: str) -> Iterator[Tie]:
    """Yield what README.md must say."""
    for plant in PLANTS:
        quick = rows("gradient.csv", case="step", plant=plant, plant_seconds=10.0, scenario="step")
        assert len(quick) == 10
        errors = pair(lambda axis: max(numbers(quick, axis)), axes=("azimuth", "pitch"))  # noqa: B023
        seconds = f"{max(numbers(quick, 'cpu_seconds')):.0f}"
        yield Tie(README, f"| `{plant}` | 10 s | {{}} rad | {{}} s |", (errors, seconds))
    yield from _without_model()
    yield from _policies()
    yield from _imagined()
    noisy = rows("gradient.csv", case="noise", plant_seconds=10.0, scenario="step")
    assert len(noisy) == 20
    edge = max(*numbers(noisy, "azimuth"), *numbers(noisy, "pitch"))
    words = "planning by gradient stays within {} rad after 10 s of data, on ten seeds of ten on both plants"
    yield Tie(README, words, (f"{edge:.4f}",))
    held = max(max(numbers(list(table("from_log.csv")), axis)) for axis in ("azimuth", "pitch"))
    yield Tie(README, "file that holds the plant within {} rad, in the worst of ten seeds", (f"{held:.4f}",))
    logs = [row for row in table("logs.csv") if row["plant"] in logged.CASES]
    runs, promised = (
        {(row["plant"], row["seed"]) for row in logs if row["foretold"] in verdicts}
        for verdicts in (("CONTROLLED", "NOT promised"), ("CONTROLLED",))
    )
    assert all(float(row["error_percent"]) <= 1 for row in logs if (row["plant"], row["seed"]) in promised)
    assert promised == runs
    words = (
        "For all {} logs of twelve other plants the command forecasts that its controller will hold the plant, "
        "and all of these hold the true plant."
    )
    yield Tie(README, words, (str(len(runs)),))
    yield Tie(README, "swings about its target without end, with errors of {} / {} rad", limit_cycle())
    words = "predicts the worst state of 32 unseen episodes, open loop, to {} % of its range"
    yield Tie(README, words, (_measured("tras", "worst state"),))
    for plant in ("cart_pole", "swing_up", "pendulum_v1"):
        assert {row["verdict"] for row in rows("plants.csv", plant=plant)} == {"CONTROLLED"}


def _without_model() -> Iterator[Tie]:
    """Yield what README.md says of the best agent without a model."""
    found = [row for plant in PLANTS for row in rows("ablation.csv", system=plant, setting="sb3_sac_5")]
    reached = sorted(int(row["episodes_to_level"]) for row in found if row["episodes_to_level"])
    assert len(found) == 10
    assert len(reached) == 8
    assert {row["episodes"] for row in found} == {"20"}
    level = str(setting("level.error", page="ablation"))
    words = "takes {} to {} episodes of 20 s to come within {} rad"
    yield Tie(README, words, (str(reached[0]), str(reached[-1]), level))
    yield Tie(README, "and two of its ten seeds do not reach {} rad in", (level,))


def _policies() -> Iterator[Tie]:
    """Yield the rows of the policies in the repository."""
    for plant in PLANTS:
        score = record(f"policies/{plant}/origin.json")["evaluation"]
        figures = [pair(lambda axis: score[f"{metric}/{axis}"]) for metric in ("steady_state_error", "rmse")]  # noqa: B023
        link = f"[`{plant}`](docs/results/policies/{plant}/origin.json)"
        yield Tie(README, f"| {link} | 30 s | {{}} | {{}} |", tuple(figures))


def _imagined() -> Iterator[Tie]:
    """Yield what README.md says of TD3 with imagined rollouts, and of TD3 without a model."""
    runs = {
        plant: rows("ablation.csv", system=plant, experiment="dyna", setting="rollouts_800") for plant in ("xi", "tras")
    }
    level = [cell(numbers(found, "episodes_to_level"), 3) for found in runs.values()]
    (reached,) = {f"{sum(bool(row['episodes_to_level']) for row in found)} of {len(found)}" for found in runs.values()}
    bound = str(setting("level.error", page="ablation"))
    words = "comes within {} rad on both axes after {} episodes on `xi` and after {} on `tras`, on {} seeds each."
    yield Tie(README, words, (bound, *level, reached))
    ends = [f"{middle(numbers(found, 'steady_state_error')):.2g}" for found in runs.values()]
    yield Tie(README, "Its errors at the end are {} and {} rad.", tuple(ends))
    plain = [row for plant in PLANTS for row in rows("ablation.csv", system=plant, setting="rollouts_0")]
    learnt = [row for row in plain if row["experiment"] == "dyna"]
    assert len(learnt) == 10
    assert sum(bool(row["episodes_to_level"]) for row in learnt) == 1
    yield Tie(README, "but without a model comes within {} rad on one seed of ten", (bound,))


PLANTS = ("tras", "xi")


def _measured(case: str, words: str, method: str = "ours") -> str:
    """Return a cell of identification.csv by its case, the beginning of its method, and words of its measure."""
    found = [
        row["value"]
        for row in rows("identification.csv", case=case)
        if row["method"].startswith(method) and words in row["measure"]
    ]
    assert found, (case, words, method)
    return found[0]


def speed(text: str) -> Iterator[Tie]:
    """Yield what docs/speed.md must say."""
    (start,) = rows("speed.csv", job="start-up")
    ours, torch = (float(start[kind]) for kind in TIMES_OF_JOBS)
    figures = (f"{ours:.2g}", f"{torch:.2g}", f"{ours / torch:.2g}")
    yield Tie(
        SPEED, "{} seconds of one core until it begins its work; `import torch` alone takes {}: {} times", figures
    )
    (then,) = rows("speed.csv", job="imagined replay xi before")
    took = [f"{float(then[kind]):.2g}" for kind in reversed(TIMES_OF_JOBS)]
    figures = (then["beside"], *took, then["commit"], f"{float(then['ratio']):.2g}")
    yield Tie(
        SPEED, "At {}, where nothing was machine code yet, it took {} seconds, and it takes {} at {}: {}", figures
    )
    others = [rows("speed.csv", job=f"{name}{ELSEWHERE}")[0] for name in list(JOBS)[:3]]
    (commit,) = {row["commit"] for row in others}
    took = [f"{per * float(row['cpu_seconds']):.2g}" for per, row in zip((1e3, 1.0, 1.0), others)]
    ratios = [f"{float(row['ratio']):.2g}" for row in others]
    words = "took {} ms, {} and {} s at {}, and torch code {}, {} and {} times as long"
    yield Tie(SPEED, words, (*took, commit, *ratios))
    told = ("start-up", "imagined replay xi before", *(row["job"] for row in others))
    for row in (row for row in table("speed.csv") if row["job"] not in told):
        per = 1e3 if row["job"] == "environment" else 1.0  # in milliseconds, or in seconds
        times = [f"{per * float(row[kind]):.2g}" for kind in TIMES_OF_JOBS]
        yield Tie(SPEED, f"| {JOBS[row['job']]} | {{}} | {{}} | {{}} |", (*times, f"{float(row['ratio']):.2g}"))
    (step,) = (float(row["cpu_seconds"]) for row in rows("speed.csv", job="environment"))
    yield Tie(SPEED, "makes {} steps in a second of one core", (f"{round(1 / step, -2):.0f}",))


ELSEWHERE = ", another computer"
TIMES_OF_JOBS = ("cpu_seconds", "beside_cpu_seconds")
JOBS = {
    "environment": "a step of `dynasindy/TwinRotor-v0` [ms]",
    "controller xi": "nothing to controller, `xi` [s]",
    "controller tras": "nothing to controller, `tras` [s]",
    "imagined replay xi": "`train.py experiment=dyna` on `xi`, five episodes, 800 rollouts a phase [s]",
}


def identification(text: str) -> Iterator[Tie]:
    """Yield what docs/identification.md must say."""
    yield Tie(IDENTIFICATION, "the trajectory has {} times the error of the windows", (str(WORSE),))
    yield Tie(IDENTIFICATION, "led through lags of {} to {} samples", (str(TIMES[0]), str(TIMES[-1])))
    yield Tie(IDENTIFICATION, "are at most {} times as large, in their geometric mean", (str(BETTER),))

    def tie(words: str, *figures: str) -> Tie:
        return Tie(IDENTIFICATION, words, figures)

    every = "19 of 19 terms and 0 false"
    for case, seconds, step, bound in (("xi_10s", 10, "0.01", "1e-6"), ("xi_control", 20, "0.05", "1e-4")):
        error = _measured(case, "worst relative coefficient error").replace("e-0", "e-")
        asked = "19 of 19 terms, 0 false, error" if case == "xi_10s" else "19/0,"
        words = f"| `xi`, {seconds} s at {{}} s, 10 seeds | {asked} <= {{}} | {{}}, worst {{}} |"
        yield tie(words, step, bound, _measured(case, every), error)
    median, worst = _measured("xi_noise", "largest error / Cramer-Rao bound").split(", ")
    words = "{} seeds have them. The largest error is {} times the bound in the median seed and {} in the worst."
    yield tie(words, _measured("xi_noise", every), median, worst)
    for case, words in (
        ("van_der_pol", "Van der Pol's oscillator, 20 s at {} s"),
        ("lorenz", "Lorenz' system, 10 s at {} s"),
    ):
        yield tie(words, {"van_der_pol": "0.02", "lorenz": "0.01"}[case])
        yield tie(*_textbook(case))
    for start, case, given in (
        ("`xi`, white noise of {} | whole", "xi, white noise of 1e-3, simulation", ["1e-3"]),
        ("white noise of {} % | whole", "van der Pol, white noise of 10 %, simulation", ["10"]),
        ("pushes that last {} s | whole", "oscillator, random pushes, simulation", [str(LASTS)]),
        ("the same | windows on their own", "oscillator, random pushes, prediction", []),
        ("a spring that its library lacks | whole", "not in the library, simulation", []),
        ("the same | windows on their own", "not in the library, prediction", []),
    ):
        told = (_measured("standard_errors", case, method) for method in ("ours", "textbook"))
        ends = [end for each in told for end in each.split(" to ")]
        yield tie(f"{start} | {{}} to {{}} | {{}} to {{}} |", *given, *ends)
    yield tie("| {} % worst state, 32 unseen episodes |", _measured("tras", "worst state"))
    better, worse = (
        next(
            r["value"] for r in rows("identification.csv", case="trms33", method=name) if "worst state" in r["measure"]
        )
        for name in ("ours, rotor_reaction", "ours, rotor")
    )
    for library, value in (("rotor_reaction", better), ("rotor", f"{float(worse):g}")):
        words = f"| `trms33`, `{library}` | the best honest figure | {{}} % worst state over 26 unseen episodes |"
        yield tie(words, value)
    refits = [f"{float(_measured('refit', size)):.2g}" for size in ("1e+06", "1e+07")]
    theirs = _measured("refit", "fit of 1e6", "PySINDy")
    yield tie("| {} ms; PySINDy {} ms |", refits[0], theirs)
    yield tie("| at most twice that | {} ms |", refits[1])
    yield tie("| {} s |", f"{float(_measured('xi_10s', 'refined fit')):.2f}")
    ours = [_measured("speed", f"{plant} model").partition(",")[0].replace("e+0", "e") for plant in ("xi", "tras")]
    yield tie(
        "| {} (`xi`), {} (`tras`); PySINDy `simulate` {} |", *ours, f"{float(_measured('speed', 'xi', 'PySINDy')):.0f}"
    )


def _textbook(case: str) -> tuple[str, ...]:
    """Return words and figures of a system at four levels of noise: exact seeds, largest errors, PySINDy's seeds."""

    def cells(words: str, method: str, place: int) -> str:
        found = [_measured(case, f"noise {level} %: {words}", method).split()[place] for level in (1, 5, 10, 20)]
        return ", ".join(found)

    exact, errors = cells("seeds with all", "ours", 0), cells("rms error", "ours", 1)
    best, weak = (cells("seeds with all", method, 0) for method in ("PySINDy, best", "PySINDy, our weak form"))
    words = (
        "Exact are {} of 10 seeds; the rms error of the worst seed is {} bounds. "
        "PySINDy at its best is exact on {} of 10, and on our weak form on {}."
    )
    return words, exact, errors, best, weak


def baselines(text: str) -> Iterator[Tie]:
    """Yield what the words of docs/results/baselines.md must say."""

    def of(plant: str, controller: str, scenario: str, metric: str, axis: str) -> float:
        found = rows(
            "baselines.csv", plant=plant, controller=controller, model="identified", scenario=scenario, metric=metric
        )
        return middle([float(row[axis]) for row in found])

    square = {
        name: [of("tras", name, "square", "rmse", axis) for axis in ("azimuth", "pitch")] for name in _CONTROLLERS
    }
    plain, integral, lqi, mpc, pid = square.values()
    yield Tie(BASELINES, "square C on `tras` ({} against {})", (short(integral[1]), short(lqi[1])))
    yield Tie(BASELINES, "Without it, it is ahead there ({}),", (short(plain[1], 3),))
    yield Tie(BASELINES, "which PID buys with its pitch ({} / {})", (short(pid[0], 3), short(pid[1], 3)))
    pairs = [f"{short(azimuth)}/{short(pitch, 3)}" for azimuth, pitch in (plain, mpc)]
    yield Tie(BASELINES, "ahead in square C on `tras` ({} against {})", tuple(pairs))
    steady = "steady_state_error"
    behind = [
        of(plant, _LEARNED[0], *case, axis) - of(plant, "LQI", *case, axis)
        for plant, case, axis in (
            ("tras", ("step", steady), "azimuth"),
            ("xi", ("step", steady), "azimuth"),
            ("xi", ("step", steady), "pitch"),
            ("xi", ("sine", "rmse"), "azimuth"),
        )
    ]
    yield Tie(BASELINES, "in the azimuth of sine B on `xi`, by {} to {} rad.", _range(behind))
    starts = [
        of(p, name, "sine", "rmse", "pitch") - of(p, "MPC", "sine", "rmse", "pitch")
        for p in ("xi", "tras")
        for name in _LEARNED
    ]
    yield Tie(BASELINES, "the start of sine B by {} to {} rad of pitch", _range(starts))
    held, left = (
        [of("tras", name, "step", steady, axis) for axis in ("azimuth", "pitch")] for name in reversed(_LEARNED)
    )
    words = "the steady error on `tras` by {} rad with integral action and {} to {} without."
    yield Tie(BASELINES, words, (_range(held)[1], *_range(left)))


def _range(values: list[float]) -> tuple[str, str]:
    """Return the least and the greatest to one digit: 2e-4."""
    return tuple(f"{value:.0e}".replace("e-0", "e-") for value in (min(values), max(values)))


_LEARNED = ("planning by gradient", "planning by gradient, integral action")
_CONTROLLERS = (*_LEARNED, "LQI", "MPC", "PID")
COMPARED = {
    "Agent training hyperparameters (the paper's table, every row)": "compared with conf/ by tests/test_docs.py",
    "What the text of the paper sets": "compared with conf/ by tests/test_docs.py",
}
"""Sections of docs/algorithm.md of which figures may stand untied."""
SIZES = "size of a download, which differs from day to day"
MUJOCO = "docs/gymnasium.md"
NOT_KEPT = "a trial whose rows were not kept; the page says so"
UNTIED = [
    Untied(MUJOCO, "stayed at errors of 31 and 37 % (one seed", NOT_KEPT),
    Untied(MUJOCO, "speeds Reacher's joints up to 200 rad/s", "gear over damping in MuJoCo's reacher.xml"),
    Untied(README, "Python 3.11, 3.12 and 3.13", "versions, as in pyproject.toml"),
    Untied("docs/quickstart.md", "You need Python 3.11, 3.12 or 3.13", "versions, as in pyproject.toml"),
    Untied(README, "[arXiv:2512.21081](https://arxiv.org/abs/2512.21081)", "the number of a paper"),
    Untied(README, "everything together takes 1.5 GB", SIZES),
    Untied("docs/algorithm.md", "([arXiv:2512.21081](https://arxiv.org/abs/2512.21081))", "the number of a paper"),
    Untied("docs/algorithm.md", "which stays within [0.707, 1]", "the range of the formula"),
    Untied(IDENTIFICATION, "the signal stays within [0.707, 1]", "the range of the formula"),
    Untied(IDENTIFICATION, "every second one sweeps to 0.7 of the last frequency", "a constant of the code"),
    Untied(IDENTIFICATION, "The threshold of the paper, lambda = 0.9,", "of the paper"),
    Untied(IDENTIFICATION, "On raw columns 0.9 would delete", "of the paper"),
    Untied(
        IDENTIFICATION,
        "have to correlate by less than -0.3. The changes of one state may do so by less than -0.6",
        "of noisy.py",
    ),
    Untied(
        IDENTIFICATION,
        "correlate by -1/2, and changes from one error to the next by -2/3 with",
        "of differences of noise",
    ),
    Untied(IDENTIFICATION, "**`xi`, 100 s, noise 1e-3.**", "the case that is measured"),
    Untied(IDENTIFICATION, "random steps held for 0.5 s, and Lorenz' system in `x'`, held for 0.2 s", "the cases"),
    Untied(IDENTIFICATION, "on top of 1e6 samples | <= 10 ms", "the case that is measured"),
    Untied(IDENTIFICATION, "the same on top of 1e7 samples", "the case that is measured"),
    Untied(IDENTIFICATION, "batch 4096 | >= 1e6", "what had to be reached"),
    Untied(IDENTIFICATION, "Random steps held for 0.5 s", "a setting of the benchmark"),
    Untied(BASELINES, "same input limits, 0.05 s of control period", "a setting of all cases"),
    Untied(BASELINES, "Horizon 1.8 s in 14 blocks", "a setting of the controller"),
    Untied(BASELINES, "weigh 1 : 0.0001 : 0.001", "settings of the controller"),
]
