"""What a run leaves behind: CSV logs as it goes, and at its end the figures, the model, the policy and a verdict."""

from __future__ import annotations

import copy
import math
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.record import TensorboardLogger

from dynasindy.control import Controller, save
from dynasindy.control.controller import NAME, ControlSetup
from dynasindy.dyna.callback import Callback, Episode, Place
from dynasindy.dyna.excite import excitation_findings
from dynasindy.dyna.experiment import Components
from dynasindy.envs import Tracking
from dynasindy.evaluation.check import thin_margin
from dynasindy.evaluation.metrics import Summary
from dynasindy.evaluation.scenarios import Evaluation, Scenario, evaluate
from dynasindy.evaluation.tracking_criteria import WITHIN, TrackingCriteria, judge_control, judge_tracking
from dynasindy.findings import Finding, note, records, weak, wrong
from dynasindy.progress import report_progress
from dynasindy.safe_io import replace_file, write_csv, write_json, write_text
from dynasindy.sindy import FitReport, SindyModel
from dynasindy.sindy.delay import delay_inputs
from dynasindy.systems.integrators import moved
from dynasindy.systems.transitions import Transitions

HEADLINE = ("return", "steady_state_error/", "rmse/")
"""How the figures of an evaluation begin that belong in the progress table."""
IDENTIFICATION = "identification.txt"
"""Name of the file of what the fit of the excitation says of itself."""
FIRST = "The first fit, of the excitation alone; model.json has the equations of the last fit that was kept."
"""Its head."""
UNEXPLAINED = 0.05
"""Part of the changes of a state beyond which a model is said to miss much of them."""


@dataclass(frozen=True)
class Evaluating:
    """When and where the policy is evaluated during a run.

    Attributes:
        scenario: Situation, without disturbances.
        every: Episodes between two evaluations, 1 or more; the last one is always evaluated.
        within: Mean absolute error at the end at which an output counts as controlled [target ranges].
        tensorboard: Whether the scalars are written for TensorBoard, too.
    """

    scenario: Scenario
    every: int = 1
    within: float = WITHIN
    tensorboard: bool = False


class Recorder(Callback):
    """Write the run folder and evaluate the policy now and then.

    `progress.csv` holds a row per real episode, `gate.csv` the gate's decisions and what became of each refit, `data/`
    what the figures are drawn from, `tensorboard/` the rows of `progress.csv` once more, if that is asked.

    Attributes:
        save: Called where a run can be left and resumed; None for no checkpoints.

    Args:
        folder: Run folder; made if missing.
        parts: What the run works on.
        evaluating: When and where the policy is evaluated.
        episodes: Episodes of the run.

    Raises:
        ModuleNotFoundError: TensorBoard is asked for and not installed.
    """

    def __init__(self, folder: Path, parts: Components, evaluating: Evaluating, episodes: int) -> None:
        if evaluating.tensorboard:
            import_module("tensorboard")  # TorchRL would complain without its name, and only when the run begins
        evaluating.scenario.length(parts.plant)  # refuses one that is too short before anything is written
        self.folder, self.parts, self.plant = folder, parts, parts.plant
        self.evaluating, self.episodes = evaluating, episodes
        self.save: Callable[[], None] | None = None
        self.rows: list[dict[str, float | None]] = []
        self.decisions: list[dict[str, float | None]] = []
        self.start, self.seconds_before = time.perf_counter(), 0.0
        self.place, self.evaluation_steps = Place(), 0
        self.excitation: list[dict[str, Any]] = []
        self.untrained: Summary = {}
        self.latest: Summary = {}

    def begin(self) -> None:
        """Evaluate the untrained policy."""
        self._open_log()
        self.untrained = self.latest = self.evaluate("untrained policy, for comparison").summary()

    def evaluate(self, phase: str = "", seconds: float | None = None) -> Evaluation:
        """Run the deployed policy, without noise, in the scenario; its steps are counted apart from the real ones.

        Args:
            phase: What is under way, in words.
            seconds: Length of the runs [s]; that of the scenario if omitted.
        """
        policy, observer = self.parts.agent.deployed, self.parts.sensing and self.parts.sensing.observer
        evaluation = evaluate(self.plant, policy, self.evaluating.scenario, observer, phase, seconds)
        moved = evaluation.trajectory["next"].get("moved", None)  # of rows that may end before the others
        self.evaluation_steps += evaluation.trajectory.numel() if moved is None else int(moved.sum())
        return evaluation

    def progress(self, done: int, note: str = "") -> None:
        """Report how many episodes are done."""
        report_progress("run", done, self.episodes, "episodes", note, outer=True)

    def fitted(self, report: object, excited: TensorDict, place: Place) -> None:
        """Write the excitation data, and what the fit says of itself and of them."""
        self.place = place
        if isinstance(report, FitReport):
            delay = getattr(self.parts.world_model, "delay", 0.0)
            text = f"found: {note('model.delay', seconds=delay)}\n" if delay else ""
            write_text(self.folder / IDENTIFICATION, f"{FIRST}\n{report.to_text()}\n{text}")
        self.excitation = records(excitation_findings(self.parts, excited))
        self.progress(0, f"real steps {place.real_steps}")
        self._write_rollout("excitation", excited)

    def episode(self, episode: Episode, place: Place) -> None:
        """Write a row, and the model's prediction of the first and of the last episode."""
        self.place = place
        last = episode.number == self.episodes
        due = last or episode.number % self.evaluating.every == 0
        if due:
            self.latest = self.evaluate().summary()
        following, error = episode.rollout["next"], episode.error
        row: dict[str, float | None] = {
            "episode": episode.number,
            "return": following["reward"].sum().item(),
            "one_step_reward_error": episode.one_step.reward_error * self.plant.task.unit,
            "reward_error": error.reward_error,
            "state_error": error.state_error,
            "model_trusted": float(episode.trusted),
            **self._spent(),
        }
        shown = {key: value for key, value in self.latest.items() if key.startswith(HEADLINE)}
        row |= {f"evaluated_{key}": value if due else None for key, value in shown.items()}
        came = f"return {row['return']:.1f}, open-loop reward error {error.reward_error:.3g}"
        self.progress(episode.number, f"{came}, real steps {place.real_steps}")
        self.rows.append(row)
        self._log_scalars(row)
        gate, test = self.parts.gate, episode.refit
        self.decisions.append(
            {
                "episode": float(episode.number),
                "reward_error": error.reward_error,
                "state_error": error.state_error,
                "judged_reward_error": None if test is None else test.error.reward_error,
                "judged_state_error": None if test is None else test.error.state_error,
                "open_below": gate.open_below,
                "close_above": gate.close_above,
                "open": float(episode.trusted),
                "held_out_error_before": None if test is None else test.error_before,
                "held_out_error_after": None if test is None else test.error_after,
                "refit_kept": None if test is None else float(test.kept),
                "stored_imagined_transitions": float(len(self.parts.replay.model)),
            }
        )
        self.write_tables()
        if last or episode.number == 1:
            when, names = "first" if episode.number == 1 else "last", self.plant.system.signature.state_names
            states = torch.cat([following["state"], error.states], -1)
            # These are the states at the end of each control period, so the first is one period old.
            columns = [*names, *(f"predicted_{name}" for name in names)]
            self._write_series(f"prediction_{when}_episode", columns, states, first=1)

    def reached(self, place: Place) -> None:
        """Save the state, if it is due."""
        if self.save is not None:
            self.save()

    def finish(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Evaluate the final policy and write `metrics.json`, the policy, the model and the step response.

        Args:
            settings: Facts to record beside the figures, such as the seed.

        Returns:
            What `metrics.json` holds; it is written last, so that a run that has it has ended.
        """
        final = self.evaluate()
        episode, words = final.representative_episode
        self._write_rollout("step_response", final.trajectory[episode], last=True)
        plant, model, sensing = self.plant, self.parts.world_model, self.parts.sensing
        observer = None if sensing is None else sensing.observer
        model.save(self.folder / "model.json")
        with replace_file(self.folder / "policy.pt") as file:
            torch.save(copy.deepcopy(self.parts.agent.deployed).cpu().state_dict(), file)
        loop = None
        if isinstance(plant.task, Tracking) and isinstance(model, SindyModel):
            # The policy with all that it needs outside of Python, unless task or model is of a kind apart.
            setup = ControlSetup(plant.task, plant.dt, plant.substeps, plant.stops)
            loop = Controller(self.parts.agent.deployed, setup, observer), model
            save(loop[0], self.folder / NAME)
        known = plant.system.known  # another simulator, or a rig, does not run for longer than was asked for
        system = plant.system if known else self.parts.model_env.system
        held = asdict(judge_tracking(final, system, self.evaluate if known else None))  # which may take longer runs
        metrics = {
            **settings,
            "episodes": len(self.rows),
            "cost": self._spent() | {"evaluation_steps": self.evaluation_steps},
            "scenario": final.scenario,
            "evaluation": final.summary(),
            "held": held,
            "units": final.units,
            "state_units": final.state_units,
            "ranges": dict(zip(final.units, final.boxes, strict=False)),
            "steady_seconds": final.steady_seconds,
            "planning": self.parts.planner.settings(),
            "imagined_error": self.parts.planner.imagined_error,
            "reward": plant.task.summary(),
            "untrained": self.untrained,
            "drawn": {"row": episode, "words": words},
            "equations": model.equations(),
            "delay": getattr(model, "delay", 0.0),
        }
        if observer is not None:
            metrics["observer"] = observer.state_dict()
            write_json(self.folder / "observer.json", metrics["observer"])
        verdict, unexplained = judge_run(metrics, self.evaluating.within, self.decisions), []
        if sensing is None:  # of which states the model misses much of the changes; noise of sensors is none
            seen = Transitions.from_periods(self.parts.replay.real_in_order(), self.parts.model_env.log_dt)
            data = delay_inputs(seen, getattr(model, "delay", 0.0))
            with torch.no_grad():
                missed = moved(model, data.x, data.u, data.dt, plant.substeps, data.u_end) - data.x_next
            shares = (missed.norm(dim=0) / (data.x_next - data.x).norm(dim=0).clamp_min(1e-300)).tolist()
            large = {n: s for n, s in zip(model.signature.state_names, shares, strict=True) if not s <= UNEXPLAINED}
            unexplained = [weak("model.unexplained", shares=large)] if large else []
        thin = thin_margin(*loop) if loop and verdict.controlled else []
        ended = [] if verdict.controlled else final.ended_runs(getattr(plant.system, "ends", None))
        findings = [*final.beyond_targets, *ended, *unexplained, *thin, *verdict.findings]
        metrics["verdict"] = {"usable": verdict.usable, "controlled": verdict.controlled}
        metrics["findings"] = [*self.excitation, *records(findings)]
        write_json(self.folder / "metrics.json", metrics)
        return metrics

    def state_dict(self) -> dict[str, Any]:
        """Return what was logged so far."""
        logged = {name: getattr(self, name) for name in self._logged}
        return {**logged, "seconds": self._seconds()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned, and bring the logs in the folder back to that state."""
        for name in self._logged:
            setattr(self, name, state[name])
        self.start, self.seconds_before = time.perf_counter(), state["seconds"]
        shutil.rmtree(self.folder / "tensorboard", ignore_errors=True)
        self._open_log()
        for row in self.rows:
            self._log_scalars(row)
        self.write_tables()

    _logged = ("rows", "decisions", "evaluation_steps", "untrained", "latest", "excitation")

    def _seconds(self) -> float:
        return self.seconds_before + time.perf_counter() - self.start

    def _spent(self) -> dict[str, float]:
        return {
            "real_steps": self.place.real_steps,
            "plant_seconds": self.place.real_steps * self.plant.dt,
            "imagined_transitions": self.place.imagined,
            "updates": self.place.updates,
            "wall_seconds": self._seconds(),
        }

    def _open_log(self) -> None:
        if self.evaluating.tensorboard:
            self.logger = TensorboardLogger(exp_name="tensorboard", log_dir=str(self.folder))

    def _log_scalars(self, row: dict[str, float | None]) -> None:
        if not self.evaluating.tensorboard:
            return
        for key, value in row.items():
            if value is not None and key != "episode":
                self.logger.log_scalar(key, value, step=int(row["episode"] or 0))
        self.logger.experiment.flush()  # shown at once, and kept if the run is killed

    def write_tables(self) -> None:
        """Write `progress.csv` and `gate.csv` as they are now."""
        for name, rows in (("progress", self.rows), ("gate", self.decisions)):
            if rows:
                write_csv(self.folder / f"{name}.csv", list(rows[0]), [list(row.values()) for row in rows])

    def _write_rollout(self, name: str, rollout: TensorDict, last: bool = False) -> None:
        """Write a row per control period, and the `last` state, after the last period, in a row without inputs."""
        signature = self.plant.system.signature
        columns = [*signature.state_names, *signature.input_names]
        columns += [f"reference_{name}" for name in self.plant.task.output_names]
        values = torch.cat([rollout["state"], rollout["action"], rollout["reference"]], -1)
        # An empty row, a gap, stands before each in which an episode begins anew.
        begun = torch.nn.functional.pad((rollout["step_count"][1:, 0] == 0).long(), (1, 0)).cumsum(0)
        gaps = values.new_full((len(values) + int(begun[-1]), values.shape[1]), math.nan)
        values = gaps.index_copy(0, torch.arange(len(values)) + begun, values)
        if last:
            empty = torch.full_like(rollout["action"][-1:], math.nan)
            end = [rollout["next", "state"][-1:], empty, rollout["reference"][-1:]]
            values = torch.cat([values, torch.cat(end, -1)])
        self._write_series(name, columns, values)

    def _write_series(self, name: str, columns: Sequence[str], values: Tensor, first: int = 0) -> None:
        # Double precision, so that the fifth period of 0.05 s is at 0.25 s and not at 0.25000000372.
        time_column = (first + torch.arange(len(values), dtype=torch.float64)).unsqueeze(-1) * self.plant.dt
        headings = self.plant.system.signature.headings(["time", *columns])
        write_csv(self.folder / "data" / f"{name}.csv", headings, torch.cat([time_column, values], -1).tolist())


class _RunVerdict(NamedTuple):
    """What a run's result is worth: whether the policy is better than the untrained one, and as `judge_control`."""

    usable: bool
    controlled: bool | None
    findings: tuple[Finding, ...]


def judge_run(
    metrics: Mapping[str, Any], within: float = WITHIN, decisions: Sequence[Mapping[str, float | None]] = ()
) -> _RunVerdict:
    """Compare the trained policy with the untrained one, and with what was asked for, in the scenario of both.

    Args:
        metrics: What a run ends with: `scenario`, the summaries `untrained` and `evaluation`, each with a
            `return`, None where it is not finite, and `held`, see `evaluation.tracking_criteria`; and the number of its
            `episodes`, without which there is no `gate.csv`.
        within: Mean absolute error at the end that is asked for, in ranges of targets.
        decisions: Rows of `gate.csv`, which tell in how many episodes the model was not trusted, and why the last time.
    """
    untrained, trained = (_number(metrics[key]["return"]) for key in ("untrained", "evaluation"))
    facts: dict[str, Any] = {"scenario": metrics["scenario"], "trained": trained, "untrained": untrained}
    if usable := trained > untrained:
        compared = note("run.better", **facts)
    else:
        compared = wrong("run.no_better", **facts, episodes=bool(metrics.get("episodes", 1)))
    controlled, tracked = judge_control([TrackingCriteria(**metrics["held"])], within, grew=usable)
    findings = [compared, tracked]
    if closed := [row for row in decisions if not row["open"] and row["judged_reward_error"] is not None]:
        last = {key: _number(value) for key, value in closed[-1].items()}
        counts = {"closed": len(closed), "episodes": len(decisions), "episode": int(last["episode"])}
        limits = {key: last[key] for key in ("open_below", "close_above")}
        findings.insert(0, weak("run.gate_closed", **counts, error=last["judged_reward_error"], **limits))
    return _RunVerdict(usable, controlled, tuple(findings))


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
