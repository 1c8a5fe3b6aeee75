"""Check a controller on its model before it touches metal: `python scripts/check.py run=PATH [low=[..] high=[..]]`."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from admitted import read_config
from command import command
from omegaconf import DictConfig, OmegaConf

from dynasindy.evaluation.given import folder_for, understood

ENDS = ("low", "high")
"""Settings of the target range."""


@command("check")
def main(cfg: DictConfig) -> None:
    """Print the verdict, write figures and numbers, and end with 1 where the loop is not stable."""
    import torch

    from dynasindy.checking import Loop, Plant, Settings, check, verdict
    from dynasindy.checking.check import record
    from dynasindy.checking.findings import in_lines
    from dynasindy.checking.verdict import in_figures, in_short, lost
    from dynasindy.evaluation.files import add_to_record, write_json
    from dynasindy.export.write import Exported
    from dynasindy.terminal import say
    from dynasindy.viz.check import draw
    from dynasindy.viz.style import save

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
    folder = folder_for(cfg.folder, run, "check")
    plant = Plant(given.model, given.controller.dt, given.step, given.stops)
    found = check(Loop(given.controller, plant), settings)
    findings = verdict(found)
    words = [{"finding": each.name, "good": each.good, "words": each.words} for each in findings]
    write_json(folder / "check.json", {"verdict": words, **record(found)})
    kept = folder.parent / "metrics.json"
    if cfg.folder is None and kept.is_file():  # of another folder nobody knows that it is of this run
        add_to_record(kept, "check", in_figures(found, findings))
    for name, figure in draw(found).items():
        save(figure, folder / name)
    say(
        "What the model predicts; the plant itself was not asked.",
        *in_lines(findings),
        in_short(found, findings),
        f"Files: {folder}",
    )
    if bool(lost(found).any()):
        sys.exit(1)


def _places(cfg: DictConfig, run: Path) -> dict[str, Any]:
    """Return the ends of the target range, as given or as the run has them, and where its episodes begin and end."""
    file = (run if run.is_dir() else run.parent) / "config.yaml"
    absent = [key for key in ENDS if cfg[key] is None]
    if absent and not file.is_file():
        raise ValueError(
            f"{absent[0]} is not given, and there is no {file} to read it from; give {absent[0]}=[...] of the targets"
        )
    with understood(file):
        kept = read_config(file) if file.is_file() else OmegaConf.create()
        plant, task = kept.get("plant") or {}, kept.get("task") or {}
        box = {key: tuple(map(float, plant[key] if key in absent else cfg[key])) for key in ENDS}
        return box | {key: _by_state(task.get(key) or plant.get(key) or {}) for key in ("start", "bounds")}


def _by_state(ends: Mapping[str, Any]) -> dict[str, Any]:
    """Return a value, or two ends, by the name of a state."""
    return {str(name): list(end) if OmegaConf.is_list(end) else float(end) for name, end in ends.items()}


if __name__ == "__main__":
    main()
