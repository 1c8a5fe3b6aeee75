"""The report: figures and tables of the paper beside ours, from saved results, and what holds of the paper's claims.

The page is `report.md.jinja`, whose gaps are filled by what is saved. Words may hold `code` and **bold**; all else of
them is shown as it stands, and is neither HTML nor a link.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import matplotlib
import numpy as np
import pandas as pd
import torch
import yaml
from matplotlib.figure import Figure

from dynasindy.evaluation.ablation import CURVES, TABLE, Level, interquartile_mean, markdown, read_ablation
from dynasindy.safe_io import escape_markdown, read_json, read_text, reading, write_text
from dynasindy.sindy import SindyModel
from dynasindy.sindy.world_model import open_loop
from dynasindy.systems.transitions import Transitions
from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.systems.xi import Xi
from dynasindy.viz.identification import BEYOND, prediction, training_data
from dynasindy.viz.learning import average_rewards, curves_of
from dynasindy.viz.response import tracking
from dynasindy.viz.run import gate, periods, read_table
from dynasindy.viz.style import Array, array, controller_name, save_figures

WIDTH = 120
SVG: dict[Any, Any] = {"svg.fonttype": "none", "path.simplify_threshold": 0.3}
"""Letters stay text, which is smaller than outlines and can be searched."""
PLANTS = ("xi", "tras")
OURS = [(plant, "dyna") for plant in PLANTS]
CASES = [(plant, experiment) for plant in PLANTS for experiment in ("dyna", "paper")]
"""What the ablation compares its settings in."""
SETTINGS = {setting: controller_name(setting) for setting in ("rollouts_0", "rollouts_400", "rollouts_800")}
NONE, SOME, MANY = SETTINGS.values()
MODEL_FREE = ("rollouts_0_tuned", "sb3_sac", "sb3_sac_5", "sb3_td3", "sb3_td3_5")
"""Other settings of the ablation that have no model, which planning is compared with too."""
STATES, INPUTS = list(SIGNATURE.state_names), list(SIGNATURE.input_names)
AXES = {"alpha_a": "azimuth", "alpha_p": "pitch"}
TRACKED, REFERENCES = list(AXES), [f"reference_{name}" for name in AXES]

EPISODES = 2500
"""Episodes after which the paper draws its controllers with a model."""
FALL = 0.1
"""Share of the first reward error that the last one is to be below, unless all are below `gate.open_below`."""
CLOSE = 5.0
"""RMSE of a state that is predicted well [% of its range]."""
COEFFICIENT = 1.0
"""Error of a coefficient that is found [%]."""
EARLY = 0.25
"""Share of the evaluations over which early rewards are averaged."""
SOON = 180
"""Real episodes within which it is no difference whether 800 or 400 rollouts are at the level first."""
LEVEL = Level().error
"""Steady-state error that is asked for of policies with planning [rad]."""
FINE = 0.01
"""Steady-state error up to which it is no difference whether that of 800 or of 400 rollouts is less [rad]."""
FOLLOWS = 0.1
"""Share of its amplitude up to which the error of a wave counts as followed."""
TRANSIENT, SETTLED = 10.0, 5.0
"""Start of a sine that does not count, and end of each level of a square wave that does [s]."""

MODEL = "A model identified from seconds of excitation, refitted as episodes come, predicts the plant."
SOONER = "Planning on the model lets the policy learn from fewer real episodes."
EXACT = "With planning the policy holds a reference more exactly than without."
WAVES = "With the model, sines and square waves are followed."
CLAIMS = (MODEL, SOONER, EXACT, WAVES)

Coefficients = Mapping[str, Mapping[str, float]]
HOLDS, SAME, SHORT = "holds", "no difference", "not reached"
"""How ours stands to a statement of the paper."""


class _Judgement(NamedTuple):
    """What a figure of the paper shows, which of its claims rests on that, ours in numbers, and the verdict."""

    statement: str
    claim: str
    ours: str
    verdict: str


class _Picture(NamedTuple):
    """A figure, the name of its file, and what it shows."""

    name: str
    figure: Figure
    caption: str


_Part = str | _Picture | _Judgement
"""A paragraph, a table in Markdown, a figure, or what was judged."""
Section = list[tuple[str, _Part]]
"""The parts of a section, each with its case of plant and experiment."""


_Made = Iterator[_Part]


def _run(results: Path, system: str, experiment: str, setting: str = "rollouts_800") -> Path:
    """Return the folder of an ablation's setting; where the experiment is `gradient`, that of the main job."""
    name = f"{system}_gradient" if experiment == "gradient" else f"{system}_{experiment}_{setting}"
    if not (results / "runs" / name / "config.yaml").is_file():
        raise FileNotFoundError(f"there is no saved run {name}")
    return results / "runs" / name


def _settings(run: Path) -> dict[str, Any]:
    text = read_text(run / "config.yaml")
    with reading(run / "config.yaml"):
        try:
            found: dict[str, Any] = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise ValueError(error) from error
    return found


def build(results: Path, folder: Path) -> list[Path]:
    """Write `report.md` with `figures/`, and return the files.

    Args:
        results: Folder with tables as CSV files, and `runs/` with saved runs.
        folder: Where to.

    Raises:
        DamagedFileError: A saved file is not what a section expects.
    """
    page = folder / "report.md"
    with reading(results):
        sections = {name: build_section(results, name) for name in SECTIONS}
        origins = {run.name: read_json(run / "origin.json") for run in sorted(results.glob("runs/*/"))}
        made = [f"`{name}`, made by `{of['command']}` at commit {of['commit']}" for name, of in origins.items()]
        write_text(page, _markdown(sections, made))
    pictures = [part for section in sections.values() for _, part in section if isinstance(part, _Picture)]
    with matplotlib.rc_context(SVG):
        return [page, *save_figures({part.name: part.figure for part in pictures}, folder / "figures", ["svg"])]


def _markdown(sections: Mapping[str, Section], sources: Sequence[str]) -> str:
    """Return the page as Markdown, whose figures are `figures/NAME.svg`."""
    loader = jinja2.PackageLoader("dynasindy.viz", "")
    page = jinja2.Environment(loader=loader, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    fill = partial(textwrap.fill, width=WIDTH, break_long_words=False, break_on_hyphens=False)
    page.filters["paragraph"] = lambda words: fill(escape_markdown(words.strip()))
    page.filters |= {"escape_markdown": escape_markdown, "judgements": _judgements}
    text = page.get_template("report.md.jinja").render(
        {name: value for name, value in globals().items() if name.isupper()},  # what verdicts depend on
        BEYOND=BEYOND,
        sections=sections,
        verdict=_verdict([pair for section in sections.values() for pair in section]),
        sources=sources,
    )
    return re.sub(r"\n{3,}", "\n\n", text.strip()) + "\n"


def _judgements(section: Section) -> str:
    """Return the table of what was judged, a column per case; nothing where nothing was."""
    judged = [(case, one) for case, one in section if isinstance(one, _Judgement)]
    cases, rows = list(dict.fromkeys(case for case, _ in judged)), dict[str, dict[str, str]]()
    for case, one in judged:
        rows.setdefault(one.statement, {})[case] = f"{one.verdict} ({one.ours})"
    table = [[what, *(of.get(case, "") for case in cases)] for what, of in rows.items()]
    return markdown(["the paper", *cases], table) if table else ""


def build_section(results: Path, name: str) -> Section:
    """Build a section from what is saved of each case; where something is missing, a line says so.

    Raises:
        DamagedFileError: What is saved is not what the section expects.
    """
    section, (builder, cases) = Section(), SECTIONS[name]
    for case in cases:
        with reading(f"what is saved of {' '.join(case)}"):
            try:
                section += [(_case(*case), part) for part in builder(results, *case)]
            except FileNotFoundError as missing:
                section.append((_case(*case), f"Not measured: {missing}."))
    return section


def _case(plant: str, experiment: str = "", *_: str) -> str:
    return f"{plant}, `{experiment}`"


def _verdict(section: Section) -> list[str]:
    """Count how many of the statements behind each claim hold: a sentence and a table."""
    judged, rows = [(name, one) for name, one in section if isinstance(one, _Judgement)], []
    for claim in CLAIMS:
        cells = []
        for case in CASES:
            verdicts = [one.verdict for name, one in judged if (one.claim, name) == (claim, _case(*case))]
            count, same = verdicts.count(HOLDS), verdicts.count(SAME)
            words = "holds" if count == len(verdicts) else "in part" if count + same else "not reached"
            share = f"{words} ({count} of {len(verdicts)}{f', {same} no difference' * bool(same)})"
            cells.append(share if verdicts else "not measured")
        rows.append([claim, *cells])
    held = [one.verdict for _, one in judged].count(HOLDS)
    words = f"How many of the statements behind each claim hold; of {len(judged)} in all {held} do."
    return [words, markdown(["what the paper claims, in our words", *(_case(*case) for case in CASES)], rows)]


def _training(results: Path, plant: str, experiment: str) -> _Made:
    run = _run(results, plant, experiment)
    table = read_table(run / "data/excitation.csv")
    substeps = int(_settings(run)["env"]["substeps"])
    samples, step = len(table) * substeps, (table["time"][1] - table["time"][0]) / substeps
    figure = training_data(table["time"], table[STATES], table[INPUTS], SIGNATURE, f"Training data of {plant}")
    caption = f"What the first model of `{plant}` was fitted to: {samples} samples, {step:.3g} s apart, and the inputs."
    yield _Picture(f"training_data_{plant}", figure, caption)


def _model_learning(results: Path, plant: str, experiment: str) -> _Made:
    run = _run(results, plant, experiment)
    table = read_table(run / "gate.csv")
    episode, error = array(table["episode"]), array(table["reward_error"])  # not finite where the replay ran away
    opened, below = episode[table["open"] == 1], float(_settings(run)["gate"]["open_below"])
    worst = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
    first, last, most = (f"{error[k]:.2g} in episode {episode[k]:.0f}" for k in (0, -1, worst))
    trusted = f"trusted from episode {opened[0]:.0f}" if len(opened) else "never trusted"
    ours = f"per period {first}, {last}, at worst {most}; {trusted}, below {below:g} on held-out windows"
    fallen = bool(error[-1] < FALL * error[0] and error[-1] < below) or bool((error < below).all())
    yield _judge("the reward error of the model is high at first and falls to almost none", MODEL, ours, fallen)
    figure = gate(table, f"SINDy model learning progress: plant {plant}, experiment {experiment}")
    caption = f"Error of the model over the episodes on `{plant}`, `{experiment}`."
    yield _Picture(f"model_learning_{plant}_{experiment}", figure, caption)


def _states(results: Path, plant: str, experiment: str, episode: str) -> _Made:
    """Judge the open-loop prediction of the first or the last real episode, and draw it."""
    run = _run(results, plant, experiment)
    table = read_table(run / f"data/prediction_{episode}_episode.csv")
    real, model = array(table[STATES]), array(table[[f"predicted_{name}" for name in STATES]])
    when = "before" if episode == "first" else "after"
    title = f"Predicted and real states {when} learning: plant {plant}, experiment {experiment}"
    figure = prediction(table["time"], real, model, SIGNATURE, title)
    caption = f"Open-loop prediction of an episode on `{plant}`, `{experiment}`."
    yield _Picture(f"states_{when}_{plant}_{experiment}", figure, caption)
    if episode == "first":
        yield _judge_model("the rotor speeds are predicted well", real, model, "omega_")
        return
    yield _judge_model("all six states are predicted closely", real, model)
    # The excitation applied to the final model, as the paper does.
    table = read_table(run / "data/excitation.csv")
    x, u = (torch.tensor(array(table[names])) for names in (STATES, INPUTS))
    dt = float(table["time"][1] - table["time"][0])
    data = Transitions(x[:-1], u[:-1], x[1:], dt, torch.zeros(len(x) - 1, dtype=torch.int64))
    predicted = open_loop(SindyModel.load(run / "model.json"), data, _settings(run)["env"]["substeps"])
    yield _judge_model("so they are when the chirp is applied again", x[1:].numpy(), predicted.numpy())


def _coefficients(results: Path, plant: str, experiment: str) -> _Made:
    run, true = _run(results, plant, experiment), _published_coefficients()
    model: Coefficients = read_json(run / "model.json")["coefficients"]
    truth, ours = (
        {(state, name): value for state, row in one.items() for name, value in row.items()} for one in (true, model)
    )
    hit, false = truth.keys() & ours, ours.keys() - truth
    worst = 100 * max((abs(ours[key] / truth[key] - 1) for key in hit), default=np.inf)
    small = max((abs(ours[key]) / max(map(abs, model[key[0]].values())) for key in false), default=0.0)
    words = f"{len(hit)} of them found, the worst {worst:.2g} % off; {len(false)} functions besides"
    words += f", the largest {small:.1g} of the largest in its equation" if false else ""
    holds = len(hit) == len(truth) and not false and worst < COEFFICIENT
    yield _judge(f"{len(truth)} coefficients are not zero", MODEL, words, holds)
    yield f"**Plant `{plant}`, `experiment={experiment}`**: as identified, the published coefficient in brackets."
    names = dict.fromkeys(name for row in (*true.values(), *model.values()) for name in row)
    rows = [
        [f"`{name}`", *(_cell(model.get(one, {}).get(name), true.get(one, {}).get(name)) for one in STATES)]
        for name in names
    ]
    yield markdown(["function", *(f"d `{state}`/dt" for state in STATES)], rows)


def _cell(ours: float | None, true: float | None) -> str:
    if ours is None and true is None:
        return ""
    return ("0" if ours is None else f"{ours:.5g}") + ("" if true is None else f" ({true:.5g})")


def _rewards(results: Path, plant: str, experiment: str) -> _Made:
    rows, runs = (
        table[(table["system"] == plant) & (table["experiment"] == experiment)]
        for table in (read_ablation(results / name) for name in (CURVES, TABLE))
    )
    rows = rows[rows["setting"].isin([*SETTINGS])]
    if rows.empty or runs.empty:
        raise FileNotFoundError(f"{CURVES} has no row of {plant}, {experiment}")
    seeds = curves_of(rows, rows["evaluated_return"])
    # What not every seed of every setting was evaluated after is not comparable.
    episodes = sorted(set.intersection(*map(set, seeds.values())))
    curves = {SETTINGS[name]: each[episodes] for name, each in seeds.items()}
    to_level = {}  # of other agents without a model, too, all of which planning has to be ahead of
    for name in (*seeds, *(each for each in MODEL_FREE if each in runs["setting"].unique())):
        own = runs[runs["setting"] == name]
        lengths = " or ".join(f"{length:g}" for length in own["episodes"].unique())
        words = SETTINGS.get(name) or f"{controller_name(name)} ({lengths} episodes)"
        to_level[words] = own["episodes_to_level"].fillna(np.inf).tolist()
    mean = {name: _middle(returns.to_numpy(copy=True).T) for name, returns in curves.items()}
    early = {name: float(values[: max(1, int(EARLY * len(values)))].mean()) for name, values in mean.items()}
    level = {name: float(_middle(values)) for name, values in to_level.items()}
    planned = [name for name in (SOME, MANY) if name in mean]
    if NONE in mean and planned:
        greater = all(early[name] > early[NONE] for name in planned)
        words = f"mean of the first {100 * EARLY:g} %: {_listed(early)}"
        yield _judge("planning has the greater rewards early", SOONER, words, greater)
        sooner = max(level[name] for name in planned) < min(level[name] for name in level if name not in planned)
        words = f"real episodes to the level: {_listed(level)}"
        yield _judge("planning reaches the required level sooner", SOONER, words, sooner)
    if len(planned) == 2:
        words = f"real episodes to the level: {_listed({name: level[name] for name in planned})}"
        statement = f"800 rollouts converge sooner than 400, there in about {SOON} episodes"
        yield _judge(statement, SOONER, words, level[MANY] < level[SOME], max(level[SOME], level[MANY]) <= SOON)
    commits = ", ".join(runs[runs["setting"].isin([*seeds])]["commit"].unique())
    command = f"python scripts/ablation.py system={plant} experiment={experiment}"
    caption = f"Returns on `{plant}`, `{experiment}`, up to {episodes[-1]:g} real episodes: `{CURVES}`, made by "
    caption += f"`{command}` at commit {commits}."
    title = f"Dyna-style vs. direct TD3, average rewards: plant {plant}, experiment {experiment}"
    yield _Picture(f"average_rewards_{plant}_{experiment}", average_rewards(curves, title), caption)


def _steps(results: Path, plant: str, experiment: str) -> _Made:
    runs = {words: _run(results, plant, experiment, name) for name, words in SETTINGS.items()}
    _, figure = _draw_tracking(runs, "step", f"Step tracking: plant {plant}, experiment {experiment}")
    scores = {words: read_json(run / "metrics.json")["evaluation"] for words, run in runs.items()}
    for name, axis in AXES.items():
        finals = {setting: score[f"steady_state_error/{name}"] for setting, score in scores.items()}
        error = {setting: np.inf if final is None else final for setting, final in finals.items()}
        planned = max(error[SOME], error[MANY])
        words = f"steady-state error [rad]: {_listed(error, 'not finite')}"
        further = f"{axis}: without planning it settles further from the reference than with it"
        yield _judge(further, EXACT, words, LEVEL >= planned < error[NONE])
        smallest = LEVEL >= error[MANY] < min(error[NONE], error[SOME])
        statement = f"{axis}: 800 rollouts have the smallest steady-state error"
        yield _judge(statement, EXACT, words, smallest, planned <= FINE)
    caption = f"A step on `{plant}`, after {_settings(runs[MANY])['train']['episodes']} episodes."
    yield _Picture(f"step_{plant}_{experiment}", figure, caption)


def _wave(results: Path, plant: str, experiment: str, shape: str) -> _Made:
    settings = ("rollouts_800", "rollouts_0")
    runs = {SETTINGS[name]: _run(results, plant, experiment, name) for name in settings}
    tables, figure = _draw_tracking(runs, shape, f"{shape.capitalize()} wave: plant {plant}, experiment {experiment}")
    time, target, output = (array(tables[MANY][names]) for names in ("time", REFERENCES, TRACKED))
    if shape == "sine":
        errors = np.sqrt(np.mean((output - target)[time >= TRANSIENT] ** 2, axis=0))
        statement = f"with the model the sine is followed (RMSE under {100 * FOLLOWS:g} % of it)"
        words = f"RMSE after {TRANSIENT:g} s: {{:.3g}} rad of {{:.3g}} rad"
    else:
        errors = array([_at_levels(time, *axis) for axis in zip(target.T, output.T, strict=True)])
        statement = "with the model each level is held with little steady-state error"
        words = f"{{:.3g}} rad over the last {SETTLED:g} s of each level of {{:.3g}} rad"
    for axis, error, size in zip(AXES.values(), errors, np.abs(target).max(0), strict=True):
        yield _judge(f"{axis}: {statement}", WAVES, words.format(error, size), bool(error < FOLLOWS * size))
    caption = f"The {shape} wave on `{plant}`, after {_settings(runs[MANY])['train']['episodes']} episodes."
    yield _Picture(f"{shape}_{plant}_{experiment}", figure, caption)


def _draw_tracking(runs: Mapping[str, Path], scenario: str, title: str) -> tuple[dict[str, pd.DataFrame], Figure]:
    step = scenario == "step"
    file = "data/step_response.csv" if step else f"evaluation/{scenario}.csv"
    tables = {words: read_table(run / file) for words, run in runs.items()}
    held = {words: periods(table, INPUTS) if step else table for words, table in tables.items()}
    first, outputs = next(iter(tables)), {words: table[TRACKED] for words, table in tables.items()}
    inputs = {words: table[INPUTS] for words, table in held.items()} if step else None
    return tables, tracking(held[first]["time"], tables[first][REFERENCES], outputs, inputs, title=title)


def _gradient_run(results: Path, plant: str, scenario: str) -> _Made:
    run = _run(results, plant, "gradient")
    title = f"{scenario.capitalize()}, policy of the main job: plant {plant}"
    _, figure = _draw_tracking({controller_name("gradient"): run}, scenario, title)
    seconds = read_json(run / "metrics.json")["cost"]["plant_seconds"]
    caption = f"The {scenario} on `{plant}` after {seconds:.0f} s of plant time."
    yield _Picture(f"gradient_{scenario}_{plant}", figure, caption)


def _judge(statement: str, claim: str, ours: str, holds: bool, same: bool = False) -> _Judgement:
    return _Judgement(statement, claim, ours, HOLDS if holds else SAME if same else SHORT)


def _judge_model(statement: str, real: Array, model: Array, kind: str = "") -> _Judgement:
    """Judge a model by the RMSE of each state of a kind [% of its range], infinite where it ran away."""
    span = np.ptp(real, axis=0)
    rmse = 100 * np.sqrt(np.mean((model - real) ** 2, axis=0)) / np.where(span > 0, span, 1.0)
    errors = {name: error for name, error in zip(STATES, np.nan_to_num(rmse, nan=np.inf)) if name.startswith(kind)}
    words = ", ".join(f"`{name}` {error:.2g}" for name, error in errors.items())
    return _judge(statement, MODEL, f"RMSE in % of range: {words}", bool(max(errors.values()) < CLOSE))


def _published_coefficients() -> Coefficients:
    """Return the paper's table "SINDY model Xi matrix", by equation and function, as the plant `xi` computes it."""
    generator, size = torch.Generator().manual_seed(0), torch.tensor(SIGNATURE.x_scale, dtype=torch.float64)
    x, u = (torch.randn(200, width, generator=generator, dtype=torch.float64) for width in (len(STATES), len(INPUTS)))
    library = SindyModel(SIGNATURE, "paper_table").library
    theta, rates = library(x * size, u), Xi()(x * size, u)
    units = theta.norm(dim=0)
    xi = torch.linalg.lstsq(theta / units, rates).solution / units.unsqueeze(-1)
    shares = (xi * units.unsqueeze(-1)).abs() / rates.norm(dim=0)
    return {
        state: {name: float(f"{xi[i, k]:.9g}") for i, name in enumerate(library.names) if shares[i, k] > 1e-9}
        for k, state in enumerate(STATES)
    }


def _at_levels(time: Array, target: Array, y: Array) -> float:
    errors = []
    for first, end in pairwise([0, *(np.flatnonzero(np.diff(target)) + 1).tolist(), len(target)]):
        late = np.arange(first, end)[time[first:end] > time[end - 1] - SETTLED]
        errors.append(np.abs(y[late] - target[first]).mean())
    return float(np.mean(errors))


def _middle(values: Iterable[float] | Array) -> Array:
    return interquartile_mean(torch.as_tensor(np.asarray(values, dtype=np.float64))).numpy()


def _listed(values: Mapping[str, float], infinite: str = "never") -> str:
    return ", ".join(f"{name} {infinite if np.isinf(value) else f'{value:.4g}'}" for name, value in values.items())


SECTIONS: Mapping[str, tuple[Callable[..., Iterable[_Part]], Sequence[tuple[str, ...]]]] = {
    "training_data": (_training, OURS),
    "model_learning": (_model_learning, CASES),
    "states_before": (partial(_states, episode="first"), CASES),
    "states_after": (partial(_states, episode="last"), CASES),
    "coefficients": (_coefficients, CASES[:2]),
    "average_rewards": (_rewards, CASES),
    "step": (_steps, CASES),
    "sine": (partial(_wave, shape="sine"), CASES),
    "square": (partial(_wave, shape="square"), CASES),
    "gradient": (_gradient_run, [(plant, scenario) for plant in PLANTS for scenario in ("step", "sine", "square")]),
}
"""What builds each section of the page, from the paper's first figure on, and of which cases."""
