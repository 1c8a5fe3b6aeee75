"""The strongest peers beside ours on the same work: controllers on our identified model, and models of the same data.

Each runs by a script of its own in a virtual environment of its own, a folder of `--environments FOLDER` that is made
if it is not there. Times are CPU seconds, user and system.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import tempfile
import time
import venv
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase

from benchmarks.common import add_choices, add_output, append, cpu_seconds
from benchmarks.gradient import CASES, KNOWN, PLANTS, build_recipe
from benchmarks.peers import serve
from dynasindy.dyna.callback import Callback
from dynasindy.dyna.experiment import Components
from dynasindy.dyna.loop import train
from dynasindy.dyna.simulated import record_plant
from dynasindy.envs import Multisine
from dynasindy.evaluation.scenarios import Scenario, evaluate, step_references
from dynasindy.export.formats import casadi_source
from dynasindy.safe_io import Row
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.systems import Tras
from dynasindy.systems.equilibria import find_equilibria

Array = NDArray[np.float64]
HERE = Path(__file__).parent
COLUMNS = (
    *("peer", "version", "case", "plant", "measure", "value"),
    *("cpu_seconds", "ms_per_action", "commit", "seed"),
)
PLANT = "tras"
CONTROLLERS: dict[str, tuple[str, dict[str, Any]]] = {
    "NeuroMANCER as documented": ("neuromancer", {"kind": "documented", "updates": 240}),
    "NeuroMANCER helped": ("neuromancer", {"kind": "helped", "updates": 280}),
    "do-mpc NMPC": ("do_mpc", {"kind": "helped"}),
    "do-mpc NMPC as written": ("do_mpc", {"kind": "written"}),
    "do-mpc ApproxMPC": ("do_mpc", {"kind": "approx", "trajectories": 60, "length": 30, "epochs": 800}),
}
"""Peers that control the plant by our model: the environment, and what its script is asked for."""
SCRIPTS = {
    "neuromancer": "neuromancer_policy.py",
    "do_mpc": "do_mpc_controllers.py",
    "jax-sysid": "jax_sysid_model.py",
    "SysIdentPy": "sysidentpy_model.py",
}
ENVIRONMENTS = {"jax-sysid": "jax_sysid", "SysIdentPy": "sysidentpy"}
NETWORKS: dict[str, dict[str, Any]] = {
    "tras": {"states": 6, "neurons": 16, "adam": 1000, "lbfgs": 1000, "decay": 0.98},
    "tanks": {"states": 3, "neurons": 8, "adam": 1000, "lbfgs": 1000, "decay": 0.95},
    "emps": {"states": 3, "neurons": 8, "adam": 500, "lbfgs": 500, "decay": 0.98},
}
"""Sizes of jax-sysid's networks, by data."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this benchmark."""
    peers = (*CONTROLLERS, *ENVIRONMENTS)
    add_choices(parser, "--peers", peers)
    parser.add_argument("--environments", type=Path, required=True, help="folder of the virtual environments")
    parser.add_argument("--logs", nargs="+", choices=tuple(NETWORKS), default=["tras"], help="data of the models")
    parser.add_argument("--data", type=Path, help="folder of the logs of `tanks` and `emps`")
    parser.add_argument("--seeds", type=int, nargs="+", default=[400])
    parser.add_argument("--targets", type=int, default=64, help="steps of 20 s that are flown")
    parser.add_argument("--tries", type=int, default=3, help="seeds among which jax-sysid chooses")
    add_output(parser, "peers")


def main(arguments: argparse.Namespace) -> None:
    """Measure ours and the peers, and append their rows."""
    torch.set_num_threads(1)

    def keep(rows: list[Row], case: str, plant: str, seed: int) -> None:
        append(arguments.out, COLUMNS, [row | {"case": case, "plant": plant, "seed": seed} for row in rows])

    for seed in arguments.seeds:
        if flying := [name for name in arguments.peers if name in CONTROLLERS]:
            case = f"controller from 10 s, {arguments.targets} targets"
            start, recipe = cpu_seconds(), build_recipe(replace(CASES["step"], episodes=0), PLANT, seed, {})
            train(parts := recipe.build(), recipe.train, Callback())
            spent = cpu_seconds() - start
            keep(judge_controller("ours", ours(), parts, None, arguments.targets, spent), case, PLANT, seed)
            for name in flying:
                keep(run_controller(name, parts, seed, arguments), case, PLANT, seed)
        for log in arguments.logs if set(arguments.peers) & set(ENVIRONMENTS) else ():
            data, mine = LOGS[log](arguments.data, seed)
            keep([mine], "model, test log simulated", log, seed)
            for name in [name for name in arguments.peers if name in ENVIRONMENTS]:
                if name == "SysIdentPy" and data["states_measured"]:
                    continue  # its models have one output
                keep([run_model(name, log, data, arguments)], "model, test log simulated", log, seed)


def ours() -> str:
    """Return our version."""
    return version("dynasindy")


def environment(folder: Path, name: str) -> Path:
    """Return the Python of a peer's environment, which is made by pip from `NAME.txt` if it is not there."""
    place = folder / name
    python = place / "bin" / "python"
    if not python.exists():
        venv.create(place, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "-q", "-r", HERE / f"{name}.txt"], check=True)
    return python


class Peer:
    """A peer's script, asked and answering line by line.

    Args:
        python: Python of its environment.
        script: Name of the script.
        asked: What it is asked for first.
    """

    def __init__(self, python: Path, script: str, asked: dict[str, Any]) -> None:
        words = [str(python), str(HERE / script)]
        own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        self.process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=own)
        self.first = self.ask(asked)
        self.seconds, self.calls = 0.0, 0

    def ask(self, asked: dict[str, Any]) -> dict[str, Any]:
        """Return the answer to a line.

        Raises:
            RuntimeError: The script ended without one; what it said stands on standard error.
        """
        assert self.process.stdin is not None and self.process.stdout is not None
        print(json.dumps(asked), file=self.process.stdin, flush=True)
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"{self.process.args} ended without an answer")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Act on states and references, as a policy."""
        x, r = (tensordict[key].double().reshape(-1, tensordict[key].shape[-1]) for key in ("state", "reference"))
        first = bool((tensordict["step_count"] == 0).all())
        answer = self.ask({"x": x.tolist(), "r": r.tolist(), "first": first})
        self.seconds, self.calls = self.seconds + answer["cpu"], self.calls + len(x)
        u = torch.tensor(answer["u"]).clamp(-1, 1).reshape(*tensordict.batch_size, -1)
        return tensordict.set("action", u)


@contextmanager
def peer(python: Path, script: str, asked: dict[str, Any]) -> Iterator[Peer]:
    """Start a peer's script, and end it."""
    found = Peer(python, script, asked)
    with found.process:  # closes its input, and waits
        yield found


def judge_controller(
    name: str, release: str, parts: Components, policy: Peer | None, targets: int, cpu: float
) -> list[Row]:
    """Return rows of errors at the end of steps on the plant; ours is timed on one target, as a peer is on each."""
    facts, deployed = PLANTS[PLANT], parts.agent.deployed
    flown = policy or deployed
    result = evaluate(parts.plant, flown, Scenario("step", step_references(facts.low, facts.high, targets), targets))
    errors = result.metrics["steady_state_error"]
    times: list[float] = []

    def _timed(tensordict: TensorDictBase) -> TensorDictBase:
        start = time.process_time()
        acted = deployed(tensordict)
        times.append(time.process_time() - start)
        return acted

    if policy is None:
        evaluate(parts.plant, _timed, Scenario("step", step_references(facts.low, facts.high, 1), 1))
        milliseconds = 1e3 * sum(times) / len(times)
    else:
        milliseconds = 1e3 * policy.seconds / policy.calls
    figures = {
        f"{kind} abs error of the last 5 s, {axis} [rad]": value
        for kind, values in (("mean", errors.mean(0)), ("worst", errors.amax(0)))
        for axis, value in zip(("azimuth", "pitch"), values.tolist(), strict=True)
    }
    head = {"peer": name, "version": release, "cpu_seconds": round(cpu, 1)}
    return [
        head | {"measure": measure, "value": f"{value:.3g}", "ms_per_action": f"{milliseconds:.3g}"}
        for measure, value in figures.items()
    ]


def nmpc_plan(model: SindyModel, dt: float) -> dict[str, Any]:
    """Return what do-mpc is to plan for, with the speeds at which the rotors rest as a hint.

    `hint` holds coefficients of monomials of the targets, by state, whose sum is h |h|, as thrust goes with the square
    of a speed; `guess` is where the first plan of a flight begins, besides the outputs at their targets.
    """
    signature, outputs, rates = model.signature, list(KNOWN), list(KNOWN.values())
    places = [signature.state_index(name) for name in outputs]
    targets = torch.cartesian_prod(*(torch.linspace(-0.5, 0.5, 7, dtype=torch.float64) for _ in outputs))
    found = find_equilibria(model, places, targets, torch.zeros(signature.n_x), dt)
    targets, rests = found.targets, found.x.numpy()
    basis = np.array([serve.monomials(row) for row in targets.tolist()])
    free = [name for name in signature.state_names if name not in (*outputs, *rates)]
    speeds = {name: rests[:, signature.state_index(name)] for name in free}
    hint = {n: np.linalg.lstsq(basis, speed * np.abs(speed), rcond=None)[0].tolist() for n, speed in speeds.items()}
    guess = {name: math.copysign(math.sqrt(abs(of[0])), of[0]) for name, of in hint.items()}
    names = {"states": signature.state_names, "inputs": signature.input_names, "outputs": outputs, "rates": rates}
    return {**names, "ranges": signature.x_scale, "dt": dt, "hint": hint, "guess": guess}


def run_controller(name: str, parts: Components, seed: int, arguments: argparse.Namespace) -> list[Row]:
    """Return rows of a peer that makes a controller from our model."""
    facts, model = PLANTS[PLANT], parts.world_model
    assert isinstance(model, SindyModel)
    which, settings = CONTROLLERS[name]
    with tempfile.TemporaryDirectory() as folder:
        asked = settings | {
            "field": casadi_source(model),
            "plan": nmpc_plan(model, parts.plant.dt) if which == "do_mpc" else None,
            **{"ranges": model.signature.x_scale, "n_u": model.signature.n_u, "dt": parts.plant.dt},
            **{"low": facts.low, "high": facts.high, "seed": seed, "folder": folder},
        }
        with peer(environment(arguments.environments, which), SCRIPTS[which], asked) as found:
            return judge_controller(name, found.first["version"], parts, found, arguments.targets, found.first["cpu"])


def run_model(name: str, log: str, data: dict[str, Any], arguments: argparse.Namespace) -> Row:
    """Return the row of a peer that identifies a model."""
    asked = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in data.items()}
    asked |= NETWORKS[log] | {"seeds": arguments.tries}
    python = environment(arguments.environments, ENVIRONMENTS[name])
    with peer(python, SCRIPTS[name], asked) as found:
        answer = found.first
    error, unit = score_model(log, np.array(answer["found"]), data)
    return row_of(name, answer["version"], error, unit, answer["cpu"])


def score_model(log: str, found: Array, data: dict[str, Any]) -> tuple[float, str]:
    """Return the root-mean-square error over the test log, and its unit: a part of the range for exact states."""
    sizes, unit = {"tras": (np.ptp(data["y"], 0), "of the range"), "tanks": (1.0, "V"), "emps": (1e-3, "mm")}[log]
    return float(np.sqrt(np.mean(((found - data["y_test"]) / sizes) ** 2))), unit


def row_of(name: str, release: str, error: float, unit: str, cpu: float) -> Row:
    """Return the row of a model."""
    head = {"peer": name, "version": release, "measure": f"RMSE, {unit}", "value": f"{error:.3g}"}
    return head | {"cpu_seconds": round(cpu, 1), "ms_per_action": ""}


def exact_states(_: Path | None, seed: int) -> tuple[dict[str, Any], Row]:
    """Return 10 s of `tras` without noise and 10 s more, and the row of our model of them."""
    facts, plant, logs = PLANTS["tras"], Tras(), []
    while len(logs) < 2:  # of the next seeds, those under which the plant meets no stop
        log = record_plant(
            plant, Multisine(2, amplitude=(0.3, 0.1), offset=(-0.11, 0.25), seed=seed).samples(0.01), 0.01, 10
        )
        logs += [log] if len(log) == 1000 else []
        seed += 1
    train_log, test_log = logs
    data = {"u": train_log.u.numpy(), "y": train_log.x.numpy(), "u_test": test_log.u.numpy()}
    data |= {"y_test": test_log.x.numpy(), "states_measured": True}
    start = time.process_time()
    model = SindyModel(
        plant.signature, facts.library, Regression("bic", tolerance=1e-4), Refinement("integral"), known=KNOWN
    )
    model.fit(train_log)
    spent = time.process_time() - start
    found = model.simulate(test_log.x[0], test_log.u, 0.01, 2)[:-1].numpy()
    return data, row_of("ours", ours(), *score_model("tras", found, data), spent)


def rig_log(rig: str, column: str, force: str, thin: int) -> Any:
    """Return a reader of the logs of a rig, with the row of our model of them."""

    def read(folder: Path | None, seed: int) -> tuple[dict[str, Any], Row]:
        from benchmarks import rigs

        if folder is None:
            raise SystemExit(f"benchmark.py peers: the logs of {rig} need --data FOLDER")
        data: dict[str, Any] = {"states_measured": False}
        for name, suffix in (("train", ""), ("test", "_test")):
            log = rigs.read_log(folder / f"{rig}_{name}.csv", {"states": [column], "inputs": [force]})[0].thinned(thin)
            data["u" + suffix], data["y" + suffix] = log.u, log.y
        rows = rigs.score(rigs.Case.of(rig, folder, folder), "ours with structure")
        (mine,) = [row for row in rows if row["metric"] == "test simulated, RMSE"]
        return data, row_of("ours", ours(), mine["value"], mine["unit"], mine["cpu_seconds"])

    return read


LOGS: dict[str, Any] = {
    "tras": exact_states,
    "tanks": rig_log("tanks", "level_2", "u", 1),
    "emps": rig_log("emps", "q", "u_force", 10),
}
