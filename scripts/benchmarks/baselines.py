"""Every controller on the same plants: same limits, same sampling, same references, same data.

A file that exists is carried on: rows it holds are not measured again. The policies of finished runs are added by
`python scripts/add_runs.py RUN...`; docs/results/baselines.md is written anew from the file each time.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from benchmarks import gradient
from benchmarks.common import TimedPolicy, add_choices, add_output, add_seeds
from benchmarks.gradient import PLANTS
from dynasindy.dyna.callback import Callback
from dynasindy.dyna.components import Components
from dynasindy.dyna.loop import train
from dynasindy.envs import ControlEnv
from dynasindy.evaluation.scenarios import Policy, Scenario, evaluate, step_references
from dynasindy.evaluation.statistics import interquartile_mean, markdown, over_seeds
from dynasindy.export.formats import field_of
from dynasindy.planning.integral import IntegralAction
from dynasindy.planning.linear_model import EquilibriumSolver, jacobians
from dynasindy.safe_io import Row, append_rows, read_rows, write_rows, write_text
from dynasindy.sindy import SindyModel
from dynasindy.systems import System
from dynasindy.systems.tracing import program
from dynasindy.tasks import Wave, references
from dynasindy.viz.controllers import controller_name

OUT = Path("docs/results/baselines.csv")
KEY = ("plant", "controller", "model", "seed")
COLUMNS = (*KEY, "real_seconds", "scenario", "metric", "azimuth", "pitch", "ms_per_action")
METRICS = ("rmse", "mean_abs_error", "steady_state_error", "control_variation")
HEADINGS = ("RMSE [rad]", "mean abs error [rad]", "steady-state error [rad]", "control variation [1/s]")
LEARNED = (controller_name("gradient"), controller_name("gradient_integral"))
RIVALS = ("LQI", "MPC")
"""Controllers of the package until they went: their rows stay in the table."""
GOALS = (("step", "steady_state_error"), ("sine", "rmse"), ("square", "rmse"))
OUTPUTS, RATES = ("alpha_a", "alpha_p"), ("Omega_a", "Omega_p")
STATE_WEIGHTS, INTEGRAL_WEIGHTS = (30.0, 30.0, 1.0, 1.0, 0.0, 0.0), (50.0, 50.0)
"""Of the linear-quadratic regulator: of squared states over their ranges, and of squared integrals [1/(rad s)^2]."""
STEPS = 64
"""Targets of the scenario of steps."""
MARK = "## Tables"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    add_choices(parser, "--plants", ("tras", "xi"))
    add_choices(parser, "--controllers", tuple(CONTROLLERS))
    add_choices(parser, "--models", ("identified", "true"))
    add_seeds(parser, 5)
    parser.add_argument("--seconds", type=float, default=0.0, help="length of every run; 0 takes the scenario's own")
    add_output(parser, "baselines")


def main(arguments: argparse.Namespace) -> None:
    """Measure controllers, models, plants and seeds, and append the rows of each as soon as they are there."""
    torch.set_num_threads(1)
    for key in cases(arguments):
        if not any(same(row, key) for row in read_rows(arguments.out)):
            plant, controller, model, seed = key
            env, policy, seconds = prepare(plant, controller, model == "true", seed)
            append(arguments.out, judge(env, policy, (*key, seconds), scenarios(plant, arguments.seconds)))
    write_tables(arguments.out)


def cases(arguments: argparse.Namespace) -> list[tuple[str, str, str, int]]:
    """Return what is to be measured; classical control of a known plant has nothing random, one seed is all."""
    found = []
    for plant in arguments.plants:
        for seed in arguments.seeds:
            for model in arguments.models:
                for controller in arguments.controllers:
                    if seed == arguments.seeds[0] or model == "identified" or controller in LEARNED:
                        found.append((plant, controller, model, seed))
    return found


def prepare(plant: str, controller: str, oracle: bool, seed: int) -> tuple[ControlEnv, Policy, float]:
    """Return the plant's environment, a controller and the seconds of plant time it took.

    Args:
        plant: Name of the plant.
        controller: Name of the controller.
        oracle: Whether the controller knows the plant; otherwise it knows the model of 10 s of excitation.
        seed: Seed of the excitation and of learning.
    """
    parts = _parts(plant, oracle, seed, controller in LEARNED)
    return parts.plant, CONTROLLERS[controller](parts), parts.plant.dt * len(parts.replay.real)


@lru_cache(maxsize=1)
def _parts(plant: str, oracle: bool, seed: int, learned: bool) -> Components:
    """Return a plant with its model identified, unless it is the plant, and with its policy planned if asked for."""
    case = replace(gradient.CASES["moving"], oracle=oracle)
    recipe = gradient.build_recipe(case, plant, seed, {} if learned else {"updates": 0})
    parts = recipe.build()
    if learned or not oracle:
        train(parts, recipe.train, Callback())
    return parts


class Lqi:
    """Linear-quadratic tracking with integral action, its gain by python-control, about the equilibrium of a reference.

    Args:
        system: The model.
        dt: Control period [s].
    """

    def __init__(self, system: System, dt: float) -> None:
        import control

        signature = system.signature
        self.dt, self.equilibria = dt, EquilibriumSolver(system, OUTPUTS)
        self.outputs = self.equilibria.outputs
        home = torch.zeros(len(OUTPUTS), dtype=torch.float64)
        a, b = jacobians(system, *self.equilibria.state_and_input(home, self.equilibria.home))
        c = np.eye(signature.n_x)[self.outputs]
        plant = control.sample_system(control.ss(a.numpy(), b.numpy(), c, 0), dt, "zoh")
        weights = [w / size**2 for w, size in zip(STATE_WEIGHTS, signature.x_scale, strict=True)]
        weights += [w * dt**2 for w in INTEGRAL_WEIGHTS]  # python-control sums errors, and does not integrate them
        gain, _, _ = control.dlqr(plant, np.diag(weights), np.eye(signature.n_u), integral_action=c)
        self.gain = torch.from_numpy(np.asarray(gain))
        self.integral = self.unknowns = torch.zeros(0)

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Act; integrals of a row hold still while one of its inputs is at a limit."""
        x, reference, rate, first = observed(tensordict, self.dt)
        if self.integral.shape != reference.shape or bool(first.all()):
            self.integral, self.unknowns = torch.zeros_like(reference), self.equilibria.home
        self.unknowns = self.equilibria(reference, self.unknowns, self.equilibria.moving(rate))
        x_e, u_e = self.equilibria.state_and_input(reference, self.unknowns)
        u = u_e - (self.gain @ torch.cat((x - x_e, self.integral), -1).unsqueeze(-1)).squeeze(-1)
        free = (u.abs() <= 1.0).all(-1, keepdim=True)
        self.integral = self.integral + free * (x[..., self.outputs] - reference)
        return tensordict.set("action", u.clamp(-1.0, 1.0).to(torch.float32))


class Nmpc:
    """Model predictive control by do-mpc; each row of a batch has a plan of its own.

    Args:
        system: The model.
        dt: Control period [s].
    """

    def __init__(self, system: System, dt: float) -> None:
        from benchmarks.nmpc import Pilot

        self.dt, self.pilot = dt, Pilot(casadi_field(system, smooth=True), nmpc_plan(system, dt, moving=True))

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Act."""
        x, reference, rate, first = observed(tensordict, self.dt)
        rows = zip(*(v.reshape(-1, v.shape[-1]).numpy() for v in (x, torch.cat([reference, rate], -1), first)))
        acts = [self.pilot.act(state, target, bool(begins), k) for k, (state, target, begins) in enumerate(rows)]
        return tensordict.set("action", torch.tensor(np.array(acts), dtype=torch.float32).reshape(*x.shape[:-1], -1))


def observed(tensordict: TensorDictBase, dt: float) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return states, references, their rates now, and whether a row begins; nothing of the future of a reference."""
    steps, reference = tensordict["step_count"], tensordict["reference"].double()
    rate = references.rate(tensordict["task_params"], steps * dt).double()
    return tensordict["state"].double(), reference, rate, steps == 0


def nmpc_plan(system: System, dt: float, **more: Any) -> Any:
    """Return what do-mpc is to plan for, with the states in which a rotor rests as a hint; see `nmpc.Plan`."""
    from benchmarks.nmpc import Plan, monomials

    signature, equilibria = system.signature, EquilibriumSolver(system, OUTPUTS)
    targets = torch.cartesian_prod(*(torch.linspace(-0.5, 0.5, 7, dtype=torch.float64) for _ in OUTPUTS))
    rests = equilibria.state_and_input(targets, equilibria(targets))[0].numpy()
    basis = np.array([monomials(row) for row in targets.tolist()])
    free = [name for name in signature.state_names if name not in (*OUTPUTS, *RATES)]
    speeds = {name: rests[:, signature.state_index(name)] for name in free}
    hint = {n: np.linalg.lstsq(basis, speed * np.abs(speed), rcond=None)[0].tolist() for n, speed in speeds.items()}
    guess = {name: math.copysign(math.sqrt(abs(of[0])), of[0]) for name, of in hint.items()}
    settings: dict[str, Any] = {"hint": hint, "guess": guess, "dt": dt} | more
    return Plan(signature.state_names, signature.input_names, signature.x_scale, OUTPUTS, RATES, **settings)


def casadi_field(system: System, smooth: bool) -> Callable[[Any, Any], list[Any]]:
    """Return a plant or a model as a function of lists of CasADi's symbols, from the formulas of its machine code."""
    from benchmarks.nmpc import functions

    signature = system.signature
    calls = functions(dict(zip(signature.state_names, signature.x_scale)) if smooth else {})
    if isinstance(system, SindyModel):
        return field_of(system, calls)
    formulas = program(system.forward, signature.n_x, signature.n_u)

    def _field(x: Any, u: Any) -> list[Any]:
        scope = {**calls, "x": x, "u": u}
        for name, formula in formulas.lines:
            scope[name] = eval(formula, scope)
        return [eval(formula, scope) for formula in formulas.results]

    return _field


CONTROLLERS: dict[str, Callable[[Components], Policy]] = {
    LEARNED[0]: lambda parts: parts.agent.deployed,
    LEARNED[1]: lambda parts: IntegralAction(parts.agent.deployed, parts.plant),
    "LQI, python-control": lambda parts: Lqi(parts.world_model, parts.plant.dt),
    "NMPC, do-mpc": lambda parts: Nmpc(parts.world_model, parts.plant.dt),
}


def scenarios(plant: str, seconds: float = 0.0) -> list[Scenario]:
    """Return scenarios A, B and C of the paper, each of its own length or of `seconds`.

    Raises:
        ValueError: The plant has none of them.
    """
    if plant not in PLANTS:
        raise ValueError(f"plant {plant} is not compared here; choose of {', '.join(PLANTS)}")
    facts = PLANTS[plant]
    return [
        Scenario("step", step_references(facts.low, facts.high, STEPS), STEPS, seconds or 20.0),
        Scenario("sine", Wave([0.35, 0.25], [0.015, 0.015]), 1, seconds or 100.0),
        Scenario("square", Wave([0.4, -0.5], [0.01, 0.01], "square"), 1, seconds or 200.0),
    ]


def judge(env: ControlEnv, policy: Policy, head: Sequence[Any], among: Iterable[Scenario]) -> list[Row]:
    """Return a row per scenario and metric.

    Args:
        env: Environment of the plant.
        policy: The controller.
        head: Values of the columns up to `real_seconds`.
        among: Scenarios; the computing time is that of those with one row.
    """
    single, rows = TimedPolicy(policy), []
    for scenario in among:
        result = evaluate(env, single if scenario.episodes == 1 else policy, scenario)
        for metric in METRICS:
            azimuth, pitch = (float(f"{value:.4g}") for value in result.metrics[metric].mean(0).tolist())
            rows.append((*head, scenario.name, metric, azimuth, pitch))
    milliseconds = float(f"{1e3 * single.seconds / single.calls:.3g}")
    return [dict(zip(COLUMNS, (*row, milliseconds), strict=True)) for row in rows]


def append(path: Path, rows: list[Row]) -> None:
    """Put rows into a file, in place of those of the same controller and seed, and print them."""
    key, old = tuple(rows[0][name] for name in KEY), read_rows(path)
    kept = [row for row in old if not same(row, key)]
    if len(kept) < len(old):
        write_rows(path, COLUMNS, [*kept, *rows])
    else:  # only appended to, so that two processes may share the file
        append_rows(path, COLUMNS, rows)
    figures = [f"{row['scenario']} {row['azimuth']} / {row['pitch']}" for row in rows if row["metric"] == METRICS[0]]
    print(f"{', '.join(map(str, key))}: RMSE {', '.join(figures)}, {rows[0]['ms_per_action']} ms", flush=True)


def same(row: Row, key: Sequence[Any]) -> bool:
    """Return whether a row belongs to a plant, controller, model and seed."""
    return [str(row[name]) for name in KEY] == [str(value) for value in key]


def write_tables(path: Path) -> None:
    """Write the tables of a CSV file into the page of the same name, after what stands above them there."""
    page = path.with_suffix(".md")
    above = page.read_text().partition(MARK)[0] if page.exists() else "# Controllers compared\n\n"
    write_text(page, f"{above}{MARK}\n\n" + "\n\n".join(tables(read_rows(path))) + "\n")


def tables(rows: Sequence[Row]) -> list[str]:
    """Return Markdown: the goals, then a table per plant and scenario, sorted by name."""
    parts = ["### Learned from 10 s of data, beside LQI and MPC on the model of the same data", goals(rows)]
    for plant in sorted({row["plant"] for row in rows}):
        for scenario in [name for name, _ in GOALS]:
            found = [row for row in rows if _matches(row, {"plant": plant, "scenario": scenario})]
            parts += [f"### `{plant}`, {scenario}", _table(found)]
    return parts


def goals(rows: Sequence[Row]) -> str:
    """Return a table of the figures by which a learned controller is to be at or ahead of LQI and MPC."""
    words = {"rmse": "RMSE", "steady_state_error": "steady-state error"}
    lines = []
    for plant in sorted({row["plant"] for row in rows}):
        for scenario, metric in GOALS:
            at = {"plant": plant, "model": "identified", "scenario": scenario, "metric": metric}
            for name, axis in product(LEARNED, ("azimuth", "pitch")):
                found = [_values(rows, {**at, "controller": other}, axis) for other in (name, *RIVALS)]
                if all(found):
                    mine, *theirs = (_middle(values) for values in found)
                    figures = [*map(_over_seeds, found), _verdict(mine, min(theirs))]
                    lines.append([plant, f"{words[metric]}, {scenario}", axis, name, *figures])
    return markdown(
        ("plant", "figure [rad]", "axis", "learned", "its", *RIVALS, "against the better of the two"), lines
    )


def _verdict(mine: float, best: float) -> str:
    word = "ahead" if mine < best else "level" if mine == best else "behind"
    return f"{word} by {abs(best - mine):.2g}"


def _table(rows: Sequence[Row]) -> str:
    header = ["controller", "model", "real data [s]", "seeds", *HEADINGS, "ms per action"]
    lines = []
    for controller, model in sorted({(row["controller"], row["model"]) for row in rows}):
        mine = {"controller": controller, "model": model}
        first = [row for row in rows if _matches(row, {**mine, "metric": METRICS[0]})]
        figures = [
            " / ".join(_over_seeds(_values(rows, {**mine, "metric": name}, axis)) for axis in ("azimuth", "pitch"))
            for name in METRICS
        ]
        seconds = sorted({round(float(row["real_seconds"])) for row in first})
        heavy = _middle([float(row["ms_per_action"]) for row in first])
        lines.append([controller, model, " to ".join(map(str, seconds)), str(len(first)), *figures, f"{heavy:.2g}"])
    return markdown(header, lines)


def _matches(row: Row, wanted: Row) -> bool:
    return all(row[name] == value for name, value in wanted.items())


def _values(rows: Sequence[Row], wanted: Row, axis: str) -> list[float]:
    return [float(row[axis]) for row in rows if _matches(row, wanted)]


def _middle(values: Sequence[float]) -> float:
    return interquartile_mean(torch.tensor(values, dtype=torch.float64)).item()


def _over_seeds(values: Sequence[float]) -> str:
    """Return the figure over seeds, a dash where there is none."""
    return over_seeds(values) if values else "-"
