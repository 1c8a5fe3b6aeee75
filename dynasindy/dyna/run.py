"""A whole run: build, train, evaluate, write the run folder, say what came of it."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dynasindy.dyna.callback import Callbacks
from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.loop import train
from dynasindy.dyna.progress import ProgressBar
from dynasindy.dyna.recorder import Recorder
from dynasindy.evaluation.scenarios import Scenario
from dynasindy.evaluation.summary import to_text


@dataclass(frozen=True)
class Evaluating:
    """When and where the policy is evaluated during a run.

    Attributes:
        scenario: Situation, without disturbances.
        every: Episodes between two evaluations; the last one is always evaluated.

    Raises:
        ValueError: `every` is not positive.
    """

    scenario: Scenario
    every: int = 1

    def __post_init__(self) -> None:
        if self.every < 1:
            raise ValueError(f"evaluation.every must be at least 1 episode, got {self.every}; give 1 or more")


def run(recipe: Recipe, evaluating: Evaluating, folder: Path, settings: str, progress: bool = True) -> dict[str, Any]:
    """Run an experiment and write its folder.

    Args:
        recipe: What to run; it is built, and so checked, before the folder is touched.
        evaluating: When and where to evaluate.
        folder: Run folder.
        settings: The resolved configuration, written beside the results.
        progress: Show a progress bar.

    Returns:
        What `metrics.json` holds.

    Raises:
        ValueError: A part refuses its settings.
    """
    parts = recipe.build()
    folder.mkdir(parents=True, exist_ok=True)
    # An interrupted run begins anew, and `metrics.json` always belongs to the config beside it.
    (folder / "metrics.json").unlink(missing_ok=True)
    shutil.rmtree(folder / "scalars", ignore_errors=True)
    (folder / "config.yaml").write_text(settings)
    episodes = recipe.train.episodes
    recorder = Recorder(folder, parts, evaluating.scenario, evaluating.every, episodes)
    bar = ProgressBar(episodes, progress)
    try:
        train(parts, recipe.train, Callbacks([recorder, bar]))
    finally:
        bar.close()
    return recorder.finish({"seed": recipe.seed, "system": type(recipe.system).__name__.lower()})


def report(metrics: dict[str, Any], folder: Path) -> str:
    """Return what a user reads at the end: equations, step tracking, cost, folder."""
    cost = metrics["cost"]
    lines = ["", "Identified equations", *(f"  {line}" for line in metrics["equations"]), ""]
    if (folder / "identification.txt").is_file():
        lines[-1:] = [f"What the excitation alone could tell, the first fit: {folder / 'identification.txt'}", ""]
    untrained = metrics["untrained"]["return"]
    title = f"Policy on the real plant, scenario '{metrics['scenario']}' (untrained return {untrained:.1f})"
    lines.append(to_text(metrics["evaluation"], title))
    lines += [
        "",
        f"Cost: {cost['real_steps']} real steps = {cost['plant_seconds']:.0f} s of plant time, "
        f"{cost['imagined_transitions']} imagined transitions, {cost['updates']} gradient updates, "
        f"{cost['wall_seconds']:.0f} s wall time; apart from these {cost['evaluation_steps']} real steps of evaluation",
        f"Run folder: {folder}",
    ]
    return "\n".join(lines)
