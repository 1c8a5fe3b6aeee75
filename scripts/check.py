"""Check a controller on its model before it touches metal: `python scripts/check.py run=PATH [low=[..] high=[..]]`."""

import sys
from pathlib import Path
from typing import Any

from cli import command


@command("check")
def main(cfg: Any) -> None:
    """Print the verdict, write figures and numbers, and end with 1 where the loop is not stable."""
    from omegaconf import OmegaConf
    from settings import read_config

    from dynasindy.evaluation.check import Settings, check, check_record, check_verdict, unstable_targets
    from dynasindy.evaluation.closed_loop import ClosedLoop
    from dynasindy.export.write import read
    from dynasindy.findings import Finding
    from dynasindy.progress import say
    from dynasindy.safe_io import add_to_json, output_folder, read_json, reading, write_json
    from dynasindy.sentences import check_lines, lines
    from dynasindy.viz.check import draw_check
    from dynasindy.viz.style import save_figures

    run = Path(cfg.run)
    controller, model = read(run)
    if controller is None or model is None:
        raise ValueError(f"{run} lacks controller or model of the plant; give the folder of a run that has ended")
    own: Any = OmegaConf.to_container(cfg)
    file, metrics = ((run if run.is_dir() else run.parent) / name for name in ("config.yaml", "metrics.json"))
    with reading(file):
        saved: Any = OmegaConf.to_container(read_config(file)) if file.is_file() else {}
        plant = saved.get("plant") or {}
        ends = {key: own[key] or plant.get(key) for key in ("low", "high")}
    if not all(ends.values()):
        raise ValueError(f"{file} holds no plant.low and plant.high; give low=[...] and high=[...] of the targets")
    tried = {key: own[key] for key in ("points", "seconds", "reach", "grid", "draws", "seed")}
    folder = output_folder(run, "check", cfg.folder)
    found = check(ClosedLoop(controller, model), Settings(**ends, **tried))
    record = check_record(found)
    if cfg.folder is None and metrics.is_file():  # of another folder nobody knows that it is of this run
        add_to_json(metrics, "check", {"stable": bool(found.stable.all()), "findings": record["findings"], **ends})
    write_json(folder / "check.json", record)
    save_figures(draw_check(found), folder, cfg.formats)
    of_run = read_json(metrics).get("findings", ()) if metrics.is_file() else ()
    missed = lines(Finding.from_record(each) for each in of_run if each["code"] == "model.unexplained")
    verdict = check_lines(check_verdict(found))
    say("What the model predicts; the plant was not asked.", *missed, *verdict, f"Files: {folder}")
    if bool(unstable_targets(found).any()):
        sys.exit(1)


if __name__ == "__main__":
    main()
