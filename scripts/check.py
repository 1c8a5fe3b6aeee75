"""Check a controller on its model before it touches metal: `python scripts/check.py run=PATH [low=[..] high=[..]]`."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cli import command

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from dynasindy.checking import Check

ENDS = ("low", "high")
"""Settings of the target range."""
STOPPED = "stopped.json"
"""What a check that was stopped had found."""


@command("check")
def main(cfg: DictConfig) -> None:
    """Print the verdict, write figures and numbers, and end with 1 where the loop is not stable."""
    import torch

    from dynasindy.checking import ClosedLoop, Plant, Settings, check, check_verdict
    from dynasindy.checking.closed_loop import step_for
    from dynasindy.checking.verdict import check_record, main_figures, unstable_targets
    from dynasindy.dyna import Stopped
    from dynasindy.export.write import Exported
    from dynasindy.progress import say
    from dynasindy.safe_io import add_to_json, output_folder, write_json
    from dynasindy.sentences import check_lines
    from dynasindy.viz.check import draw_check
    from dynasindy.viz.style import save_figures

    torch.set_num_threads(cfg.threads)
    if cfg.run is None:
        raise ValueError("run is not given; give run=PATH, a run folder or a controller.json")
    run = Path(cfg.run)
    given = Exported.read(run)
    if given.controller is None or given.model is None:
        lack = "controller" if given.controller is None else "model of the plant"
        raise ValueError(f"{run} has no {lack}; give the folder of a run that has ended, with controller and model")
    settings = Settings(
        **_places(cfg, run), **{key: cfg[key] for key in ("points", "seconds", "reach", "grid", "draws", "seed")}
    )
    folder = output_folder(run, "check", cfg.folder)
    step = step_for(given.model, given.controller.setup, given.step)
    loop = ClosedLoop(given.controller, Plant(given.model, given.controller.dt, step, given.stops))
    kept: list[Check] = []  # what was found until now, the latest last
    try:
        found = check(loop, settings, kept.append)
    except KeyboardInterrupt as stop:
        if not kept:
            raise
        raise Stopped(_keep(kept[-1], folder / STOPPED), getattr(stop, "signal", 2)) from stop
    findings = check_verdict(found)
    write_json(folder / "check.json", check_record(found, findings))
    (folder / STOPPED).unlink(missing_ok=True)
    metrics = folder.parent / "metrics.json"
    if cfg.folder is None and metrics.is_file():  # of another folder nobody knows that it is of this run
        add_to_json(metrics, "check", main_figures(found, findings))
    save_figures(draw_check(found), folder)
    say(
        "What the model predicts; the plant itself was not asked.",
        *check_lines(findings),
        f"Files: {folder}",
    )
    if bool(unstable_targets(found).any()):
        sys.exit(1)


def _keep(found: Check, file: Path) -> str:
    """Write what was found until a check was stopped, and say so in one line."""
    from dynasindy.checking import check_verdict
    from dynasindy.checking.verdict import check_record
    from dynasindy.safe_io import write_json

    findings = check_verdict(found)
    write_json(file, check_record(found, findings))
    weak = [each.code.partition(".")[2].replace("_", " ") for each in findings if each.severity != "note"]
    of_them = f"weak in {', '.join(weak)}" if weak else "none of them weak"
    count = f"{len(findings)} finding{'s' * (len(findings) > 1)}"
    return (
        f"stopped; {count}, {of_them}, kept in {file}; not looked at: {', '.join(found.left)}; the same command "
        "begins anew"
    )


def _places(cfg: DictConfig, run: Path) -> dict[str, Any]:
    """Return the ends of the target range, as given or as the run has them, and where its episodes begin and end."""
    from omegaconf import OmegaConf
    from trust import read_config

    from dynasindy.safe_io import reading

    file = (run if run.is_dir() else run.parent) / "config.yaml"
    absent = [key for key in ENDS if cfg[key] is None]
    if absent and not file.is_file():
        raise ValueError(
            f"{absent[0]} is not given, and there is no {file} to read it from; give {absent[0]}=[...] of the targets"
        )
    with reading(file):
        kept = read_config(file) if file.is_file() else OmegaConf.create()
        plant, task = kept.get("plant") or {}, kept.get("task") or {}
        box = {key: tuple(map(float, plant[key] if key in absent else cfg[key])) for key in ENDS}
        return box | {key: _by_state(task.get(key) or plant.get(key) or {}) for key in ("start", "bounds")}


def _by_state(ends: Mapping[str, Any]) -> dict[str, Any]:
    """Return a value, or two ends, by the name of a state."""
    return {str(name): float(end) if isinstance(end, int | float) else list(end) for name, end in ends.items()}


if __name__ == "__main__":
    main()
