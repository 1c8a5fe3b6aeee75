"""Check a controller on its model before it touches metal: `python scripts/check.py run=PATH [low=[..] high=[..]]`."""

import sys
from pathlib import Path
from typing import Any

from admitted import read_config
from command import command
from omegaconf import DictConfig, OmegaConf

from dynasindy.evaluation.given import folder_for, understood


@command("check")
def main(cfg: DictConfig) -> None:
    """Print the verdict, write figures and numbers, and end with 1 where the loop is not stable."""
    import torch

    from dynasindy.checking import Loop, Plant, Settings, check, verdict
    from dynasindy.checking.check import record
    from dynasindy.checking.verdict import in_figures, in_short, lost
    from dynasindy.evaluation.files import add_to_record, write_json
    from dynasindy.export.write import Exported
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
    box: dict[str, Any] = {key: _box(cfg, run, key) for key in ("low", "high")}
    box |= {key: _kept(run, key) for key in ("start", "bounds")}
    settings = Settings(**box, **{key: cfg[key] for key in ("points", "seconds", "reach", "grid", "draws", "seed")})
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
    print(
        "What the model predicts; the plant itself was not asked.",
        *findings,
        in_short(found, findings),
        f"Files: {folder}",
        sep="\n",
    )
    if bool(lost(found).any()):
        sys.exit(1)


def _box(cfg: DictConfig, run: Path, key: str) -> tuple[float, ...]:
    """Return one end of the target range, as it is given or as the run has it."""
    values, file = cfg[key], (run if run.is_dir() else run.parent) / "config.yaml"
    if values is None and not file.is_file():
        raise ValueError(f"{key} is not given, and there is no {file} to read it from; give {key}=[...] of the targets")
    with understood(file):
        return tuple(float(value) for value in (read_config(file).plant[key] if values is None else values))


def _kept(run: Path, key: str) -> dict[str, Any]:
    """Return where episodes of the run begin, or the limits of its states; nothing if there is no run to say it."""
    file = (run if run.is_dir() else run.parent) / "config.yaml"
    if not file.is_file():
        return {}
    with understood(file):
        kept = read_config(file)
        parts = (kept.get("task") or {}, kept.get("plant") or {})
        found = next((part[key] for part in parts if part.get(key)), {})
        return {str(name): list(ends) if OmegaConf.is_list(ends) else float(ends) for name, ends in found.items()}


if __name__ == "__main__":
    main()
