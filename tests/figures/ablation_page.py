"""docs/ablation.md: the tables of the ablation, of its controls and of what the settings rest on."""

import re
from collections.abc import Iterator
from functools import partial

from tables import TRIAL, cell, middle, numbers, pair, rows, setting, short, table
from ties import Tie, Untied

PAGE = "docs/ablation.md"
ERRORS = ("steady_state_error/alpha_a", "steady_state_error/alpha_p")
LAST = {"xi": 12, "tras": 16}
"""Episodes after which the controls are compared."""
RESULTS = {
    "plant time to the level [s]": "plant_seconds_to_level",
    "final error [rad]": "steady_state_error",
    "area under the curve": "area_under_curve",
    "return at the end": "final_return",
}
SETTINGS = ("rollouts_800", "rollouts_400", "rollouts_0")
QUICK = {"learning_rate": 0.001, "layer_norm": "False", "policy_average": 0.001, "error_scale": 0.5}
FIRST = {
    **QUICK, "system": "tras", "gamma": 0.95, "lr_decay": 0, "error_shape": "linear", "tau": 0.005,
    "target_update_interval": 2, "policy_noise": 0.1, "noise_min": 0.05, "generations": 1, "seed": 0,
}  # fmt: skip
TARGETS = {"tau": 0.01, "target_update_interval": 1}
SMOOTH = {**TARGETS, "policy_noise": 0.03, "noise_min": 0.02}
LOG = {"error_shape": "logarithmic", "gamma": 0.97}
TUNING = {
    ("`tras` 0", "the first settings"): {},
    ("`tras` 0", "cost logarithmic in large errors"): {"error_shape": "logarithmic"},
    ("`tras` 0", "gamma 0.97"): LOG,
    ("`tras` 0", "targets at 0.01 every update"): {**LOG, **TARGETS},
    ("`tras` 0", "smoothing 0.03, exploration to 0.02"): {**LOG, **SMOOTH},
    ("`tras` 1", "the same"): {**LOG, **SMOOTH, "seed": 1},
    ("`tras` 1", "transitions of five models kept"): {**LOG, **SMOOTH, "seed": 1, "generations": 5},
    ("`xi` 0", "as the last but one"): {**LOG, **SMOOTH, "system": "xi"},
    ("`xi` 0", "learning rates lose 5e-5 per update"): {**LOG, **SMOOTH, "system": "xi", "lr_decay": 5e-05},
    ("`xi` 0", "no loss; five models kept"): {
        **LOG, **SMOOTH, "system": "xi", "generations": 5,
    },
}  # fmt: skip
"""What each row of the table changed, against the first."""
WIDE = {"learning_rate": 0.001, "policy_noise": 0.03, "noise_min": 0.1, "layer_norm": "False"}
WIDE_SLOW = {**WIDE, "learning_rate": 0.0003}
MODEL_FREE = {
    "nothing": {**WIDE, "noise_min": 0.02},
    "exploration noise from 0.3 down to 0.1": WIDE,
    "that, and learning rates of 3e-4": WIDE_SLOW,
    "both, and smoothing noise of 0.1, bounded at 0.3": {**WIDE_SLOW, "policy_noise": 0.1},
    "both, and layer normalisation of the critics": {**WIDE_SLOW, "layer_norm": "True"},
}
"""What each trial without a model changed."""


def ties(text: str) -> Iterator[Tie]:
    """Yield what the page must say."""
    yield from _results()
    took = sum(sum(numbers(_runs("xi", name), "wall_seconds")) for name in SETTINGS)
    yield Tie(PAGE, "Its fifteen runs lasted {} minutes, added up", (f"{took / 60:.1f}",))
    yield from _controls(text)
    yield from _paper(text)
    yield from _paper_on_gpu()
    yield from _paper_in_full()
    yield from _paper_with_our_library()
    yield from _tuning()
    yield from _tuned_without_model()
    yield from _without_model()
    yield from _words()


def _runs(plant: str, name: str, experiment: str = "dyna") -> list[dict[str, str]]:
    return rows("ablation.csv", system=plant, experiment=experiment, setting=name)


def _reached(found: list[dict[str, str]]) -> str:
    return f"{sum(bool(row['episodes_to_level']) for row in found)}/{len(found)}"


def _results() -> Iterator[Tie]:
    for plant in ("xi", "tras"):
        runs = [_runs(plant, name) for name in SETTINGS]
        # What never reached the level has no interval to show.
        level = [cell(numbers(found, "episodes_to_level")).replace("never [never, never]", "never") for found in runs]
        seeds = [f"{words} ({_reached(found)} seeds)" for words, found in zip(level, runs)]
        yield Tie(PAGE, f"| `{plant}`, real episodes to the level | {{}} | {{}} | {{}} |", tuple(seeds))
        for words, column in RESULTS.items():
            figures = [cell(numbers(found, column)).replace("never [never, never]", "never") for found in runs]
            yield Tie(PAGE, f"| `{plant}`, {words} | {{}} | {{}} | {{}} |", tuple(figures))


def _controls(text: str) -> Iterator[Tie]:
    """Yield the rows of the table of controls, whichever stand there."""
    part = text.partition("## Controls")[2].partition("\n## ")[0]
    for plant, name in re.findall(r"^\| `(\w+)`, `([^`]+)` \|", part, re.M):
        runs = _runs(plant, name)
        level = cell(numbers(runs, "episodes_to_level")).replace("never [never, never]", "never")
        error = cell(_errors(plant, name, LAST[plant]))
        figures = (str(len(runs)), _reached(runs), level, error)
        yield Tie(PAGE, f"| `{plant}`, `{name}` | {{}} | {{}} | {{}} | {{}} |", figures)


def _errors(plant: str, name: str, episode: int) -> list[float]:
    """Return the error of the worse axis of each seed after an episode."""
    found = rows("ablation_curves.csv", system=plant, experiment="dyna", setting=name, episode=episode)
    return [max(float(row[f"evaluated_{column}"]) for column in ERRORS) for row in found]


def _paper(text: str) -> Iterator[Tie]:
    part = text.partition("## The paper's experiment")[2].partition("\n## ")[0]
    for plant, name in re.findall(r"^\| `(\w+)`, `([^`]+)` \|", part, re.M):
        runs = _runs(plant, name, "paper")
        columns = ("final_return", "area_under_curve", "steady_state_error")
        figures = (str(len(runs)), runs[0]["episodes"], *(cell(numbers(runs, column)) for column in columns))
        yield Tie(PAGE, f"| `{plant}`, `{name}` | {{}}, {{}} | {{}} | {{}} | {{}} |", figures)


def lockstep(name: str, episode: int) -> str:
    """Return the error of the worse axis of each seed of the paper's experiment on `xi` after an episode."""
    found = rows("ablation_curves.csv", system="xi", experiment="paper", setting=name, episode=episode)
    worst = [max(float(row[f"evaluated_{column}"]) for column in ERRORS) for row in found]
    return ", ".join(short(error, 3) for error in worst)


def _paper_on_gpu() -> Iterator[Tie]:
    for name in SETTINGS:
        words = {"rollouts_0": "none"}.get(name, name.removeprefix("rollouts_"))
        figures = tuple(lockstep(name, episode) for episode in (60, 180, 300, 600))
        yield Tie(PAGE, f"| {words} | {{}} | {{}} | {{}} | {{}} |", figures)
    yield Tie(PAGE, "Here the errors are at {} rad by then", (lockstep("rollouts_800", 180),))
    ends = {name: sorted(lockstep(name, 600).split(", ")) for name in SETTINGS}
    words = "the worst seed with 800 rollouts is at {} rad, and the best one without at {} rad."
    yield Tie(PAGE, words, (ends["rollouts_800"][-1], ends["rollouts_0"][0]))


def _paper_with_our_library() -> Iterator[Tie]:
    """Yield the runs on `tras` with `world_model=sindy`, one seed a setting, as far as they went."""
    for name in ("rollouts_800", "rollouts_0"):
        own = rows("paper_in_full.csv", system="tras", setting=f"{name},world_model=sindy", seed=0)
        episodes = [int(row["episode"]) for row in own]
        assert episodes == list(range(10, episodes[-1] + 1, 10)) and episodes[-1] >= 800
        assert min(max(float(row["azimuth"]), float(row["pitch"])) for row in own) > 0.05  # the required level
        (*_, last), at = own, {int(row["episode"]): row for row in own}
        shown = [
            pair(lambda axis, row=row: float(row[axis]), 3, axes=("azimuth", "pitch"))
            for row in (*(at[episode] for episode in (60, 180, 300, 600)), last)
        ]
        cells = (last["episode"], *shown, f"{float(last['evaluated_return']):.0f}")
        yield Tie(PAGE, f"| `tras`, {name.removeprefix('rollouts_')}, our library |" + " {} |" * len(cells), cells)


def _paper_in_full() -> Iterator[Tie]:
    def after(run: str, seed: int, episode: int, digits: int = 3) -> str:
        (row,) = rows("paper_in_full.csv", system="xi", setting=run, seed=seed, episode=episode)
        return pair(lambda axis: float(row[axis]), digits, axes=("azimuth", "pitch"))

    ours = rows("paper_in_full.csv", system="xi")
    for run, seed in sorted({(row["setting"], int(row["seed"])) for row in ours}):
        last = max(int(row["episode"]) for row in rows("paper_in_full.csv", system="xi", setting=run, seed=seed))
        shown = [f" {after(run, seed, at)} " if at <= last else " " for at in (60, 180, 220, 600, 1200)]
        yield Tie(PAGE, f"| {run.removeprefix('rollouts_')}, {seed} |" + "{}|" * len(shown), tuple(shown))
    words = "| {} | {} | {} | {} |"
    curves = {name: [_curve(name, seed) for seed in range(3)] for name in SETTINGS}
    for name, told in zip(SETTINGS, ("800", "400", "none"), strict=True):
        means, ends, errors = ([run[k] for run in curves[name]] for k in range(3))
        yield Tie(PAGE, words, (told, cell(means), cell(ends), cell(errors)))
    ends = [after(name, seed, 1200, 4) for name in SETTINGS for seed in range(3)]
    yield Tie(
        PAGE, "With 800 rollouts they end at {}, at {} and at {}, with 400 at {}, at {} and at {},", tuple(ends[:6])
    )
    yield Tie(PAGE, "without rollouts at {}, at {} and at {} (azimuth / pitch", tuple(ends[6:]))
    many, few, none = (curves[name] for name in SETTINGS)
    times = max(run[0] for run in few) / min(run[0] for run in many)
    yield Tie(PAGE, "return of the whole curve that is at least {} times as good", (f"{times:.2g}",))
    soon = [f"{max(_axes(name, seed, 180)):.3g}" for name in SETTINGS[:2] for seed in range(3)]
    shown = [f"{float(error):.2f}" if float(error) > 1 else error.removeprefix("0") for error in soon]
    words = "After 180 episodes the errors are {}, {} and {} rad with 800, and {}, {} and {} rad with 400."
    yield Tie(PAGE, words, tuple(shown))
    # As the page says of the ends, and of the level at any evaluation.
    at_end = [sorted(run[2] for run in runs) for runs in (many, few, none)]
    assert at_end[0][-1] < at_end[1][0] and at_end[2][0] < at_end[1][0] and at_end[1][-1] < at_end[2][1]
    assert all(float(row["azimuth"]) > 0.05 or float(row["pitch"]) > 0.05 for row in ours)


def _axes(setting: str, seed: int, episode: int) -> tuple[float, float]:
    (row,) = rows("paper_in_full.csv", system="xi", setting=setting, seed=seed, episode=episode)
    return float(row["azimuth"]), float(row["pitch"])


def _curve(setting: str, seed: int) -> tuple[float, float, float]:
    """Return the mean return of a run, its last return, and its error at the end."""
    own = rows("paper_in_full.csv", system="xi", setting=setting, seed=seed)
    assert [int(row["episode"]) for row in own] == list(range(10, 1201, 10))
    returns = numbers(own, "evaluated_return")
    return sum(returns) / len(returns), returns[-1], max(_axes(setting, seed, 1200))


def _tuned(changed: dict[str, object], episode: int) -> str:
    found = [
        row
        for row in table("tuning.csv")
        if all(row[key] == str(value) for key, value in {**FIRST, **changed, "episode": episode}.items())
    ]
    assert len(found) <= 1
    return pair(lambda axis: float(found[0][axis]), 3, axes=ERRORS) if found else ""


def _tuning() -> Iterator[Tie]:
    settings = (FIRST["gamma"], FIRST["tau"], FIRST["policy_noise"])
    words = "gamma {}, targets at {} every second update, and smoothing noise of {}."
    yield Tie(PAGE, words, tuple(map(str, settings)))
    for (run, words), changed in TUNING.items():
        figures = tuple(f" {shown}" if (shown := _tuned(changed, n)) else "" for n in (4, 6, 8, 10, 12))
        yield Tie(PAGE, f"| {run} | {{}} |{{}} |{{}} |{{}} |{{}} |{{}} |", (words, *figures))


def _tuned_without_model() -> Iterator[Tie]:
    for words, changed in MODEL_FREE.items():
        found = {row["episode"]: row for row in rows("tuning.csv", rollouts=0, **changed)}
        ends = (found.get(str(n)) for n in (2, 4, 6, 8))
        figures = (f" {pair(partial(_number, row), 3, axes=ERRORS)}" if row else "" for row in ends)
        yield Tie(PAGE, "| {} |{} |{} |{} |{} |", (words, *figures))

    names = ("rollouts_0_tuned", "rollouts_0", "sb3_sac_5", "rollouts_800")
    ends = tuple(_end("xi", name, 3) for name in names)
    yield Tie(
        PAGE,
        "worse axis is {} rad. For comparison, it is {} with `rollouts_0`, {} with SAC and five updates per step (five "
        "seeds), and {} with 800 rollouts.",
        ends,
    )
    ends = tuple(_end("tras", name, 3) for name in ("rollouts_0_tuned", "rollouts_0", "rollouts_800"))
    words = "on the worse axis is {} rad, where it is {} with `rollouts_0` (five seeds) and {} with 800 rollouts."
    yield Tie(PAGE, words, ends)


def _without_model() -> Iterator[Tie]:
    """Yield the episode in which each seed of the agents without a model reached the level."""
    agents = {"sac_5": "SAC, five updates per step", "sac": "SAC, its defaults"}
    for plant in ("xi", "tras"):
        for name, words in (agents | ({"td3_5": "TD3, five updates per step"} if plant == "xi" else {})).items():
            found = [row["episodes_to_level"] for row in _runs(plant, f"sb3_{name}")]
            lost = found.count("")
            told = [episode for episode in found if episode]
            told += ["not within 20" + (f" on {NUMBERS[lost]} seeds" if lost > 1 else "")] if lost else []
            yield Tie(PAGE, f"| {words} | `{plant}` | {{}} |", (", ".join(told),))
    none = [*_runs("xi", "sb3_td3"), *_runs("tras", "sb3_td3"), *_runs("tras", "sb3_td3_5")]
    assert not any(row["episodes_to_level"] for row in none)


NUMBERS = ("no", "one", "two", "three", "four")


def _number(row: dict[str, str], column: str) -> float:
    return float(row[column])


def _words() -> Iterator[Tie]:
    level = setting("level.error", page="ablation")
    yield Tie(PAGE, "over 64 fixed step references is at most {} rad on both axes", (str(level),))
    judged = {plant: max(_judged(plant)) for plant in ("xi", "tras")}
    figures = (f"{judged['xi']:.1g}", short(judged["tras"]), str(setting("gate.close_above", "experiment=dyna")))
    words = "was at most {} per control period on `xi` and {} on `tras`, and the gate closes at {}."
    yield Tie(PAGE, words, figures)
    yield Tie(PAGE, "(`rollouts_0`: {} rad after 12 episodes)", (short(middle(_errors("xi", "rollouts_0", 12)), 3),))
    shares = [f"{setting('replay.real_ratio', f'+setting=real_share_{name}')}" for name in ("05", "50")]
    default = str(setting("replay.real_ratio", "experiment=dyna"))
    yield Tie(
        PAGE,
        "Shares from {} to {} make no difference that these seeds could show. The default of {} stays.",
        (*shares, default),
    )
    (row,) = rows("tuning.csv", system="tras", learning_rate=0.0003, episode=10)
    ends = tuple(f"{float(row[column]):.2f}" for column in ERRORS)
    yield Tie(PAGE, "(earlier rows). At {}, the error on `tras` is {} / {} rad after ten episodes.", ("3e-4", *ends))
    (row,) = rows("tuning.csv", error_scale=0.1, episode=12)
    yield Tie(
        PAGE,
        "on `tras` the policy still swung, by {} / {} rad, after 12 episodes",
        tuple(f"{float(row[column]):.2g}" for column in ERRORS),
    )
    ends = [_end("xi", "horizon_20", 3), _end("tras", "horizon_20", 3)]
    yield Tie(PAGE, "in the real tenth of its batches only. It ends at {} rad on `xi` and at {} on `tras`", tuple(ends))
    ends = [_end("xi", "rollouts_800", 3), _end("tras", "rollouts_800", 3)]
    yield Tie(PAGE, "With rollouts of 5 s it ends at {} and {}.", tuple(ends))


def _end(plant: str, name: str, places: int) -> str:
    return short(middle(_errors(plant, name, LAST[plant])), places)


def _judged(plant: str) -> list[float]:
    """Return the reward errors on which the gate of the saved runs decided."""
    return [
        float(row["judged_reward_error"])
        for name in ("rollouts_400", "rollouts_800")
        for row in table(f"runs/{plant}_dyna_{name}/gate.csv")
        if row["judged_reward_error"]
    ]


UNTIED = [
    Untied(PAGE, "took 14.3 minutes on two cores", "wall time of the command, which no table holds"),
    Untied(PAGE, "explores with Gaussian noise of 0.1, as published", "setting of scripts/benchmarks/model_free.py"),
    Untied(PAGE, "at .058 and .059 rad (worse axis) after 12 episodes and at .019 after 20", TRIAL),
    Untied(PAGE, "One seed of SAC with its defaults was at .032 after 12", TRIAL),
    Untied(PAGE, "which does not explore, at .8", TRIAL),
    Untied(PAGE, "stood within .002 to .004 rad after 12", TRIAL),
    Untied(PAGE, "reward errors of up to 0.9 per period", "log of a gate that was not kept; the page says so"),
    Untied(PAGE, "The level of `experiment=dyna`, 0.05 rad in three evaluations", "level of conf/ablation.yaml"),
    Untied(PAGE, "## What stalls TD3 near 0.1 rad", "a heading in round numbers"),
    Untied(
        PAGE, "2000 updates per episode and 1e-3 learning rates", "column learning_rate by which the rows are chosen"
    ),
    Untied(PAGE, "The difference between 0.05 and 0.01 rad was a few thousandths", "round numbers of an argument"),
    Untied(PAGE, "At 0.005 every second update a renewal takes some 400", "arithmetic on a setting of the table above"),
    Untied(PAGE, "gamma 0.95, linear cost)", "columns by which the row is chosen"),
    Untied(PAGE, "explores with noise from 0.15 down to 0.02", "settings of conf/agent/td3.yaml"),
    Untied(PAGE, "Averaging the value over inputs 0.1 around it", "setting of the table above"),
]
