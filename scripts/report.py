"""The paper's figures and tables beside ours: `python scripts/report.py [save=runs/ablation | save=RUN name=NAME]`."""

from pathlib import Path

import torch
from command import command
from omegaconf import DictConfig, OmegaConf
from saved_run import load_config, load_policy, load_scenario

from dynasindy.evaluation.files import save_evaluation
from dynasindy.evaluation.saved import keep_run
from dynasindy.evaluation.scenarios import evaluate
from dynasindy.viz.report.build import build
from dynasindy.viz.report.sources import Results


@command("report")
def main(cfg: DictConfig) -> None:
    """Save runs if asked to, then build the report from all that is saved."""
    torch.set_num_threads(cfg.threads)
    results = Path(cfg.results)
    for folder, name in chosen(cfg).items():
        measure(folder, cfg.scenarios)
        origin, model = {"command": made_by(folder), "commit": cfg.commit}, folder.parent.name not in cfg.slim
        files = keep_run(folder, results / "runs" / name, origin, model)
        print(f"saved {results / 'runs' / name}: {sum(file.stat().st_size for file in files) / 1000:.0f} kB")
    settings = {
        file.parent.name: OmegaConf.to_container(OmegaConf.load(file)) for file in results.glob("runs/*/config.yaml")
    }
    files = build(Results(results, settings), Path(cfg.output), list(cfg.formats))
    print(f"{files[0]} and {files[1]}, from {len(settings)} saved runs")


def chosen(cfg: DictConfig) -> dict[Path, str]:
    """Return the run folders to save, and the names of their copies."""
    if cfg.save is None:
        return {}
    root = Path(cfg.save)
    if (root / "config.yaml").is_file():
        return {root: cfg.name or root.name}
    found = sorted(file.parent for file in root.rglob(f"seed_{cfg.seed}/metrics.json"))
    if not found:
        raise FileNotFoundError(f"{root} holds no finished run of seed {cfg.seed}; give a run folder, or runs/ablation")
    return {folder: "_".join(folder.relative_to(root).parts[:-1]) for folder in found}


def measure(folder: Path, scenarios: list[str]) -> None:
    """Evaluate a run in the scenarios in which it was not evaluated since it ended."""
    config, ended = load_config(folder), (folder / "metrics.json").stat().st_mtime
    files = {name: folder / "evaluation" / f"{name}.json" for name in scenarios}
    due = [name for name, file in files.items() if not file.is_file() or file.stat().st_mtime < ended]
    if due:
        env, policy = load_policy(config, folder)
    for name in due:
        save_evaluation(evaluate(env, policy, load_scenario(name, config)), folder / "evaluation")


def made_by(folder: Path) -> str:
    """Return the command of an ablation's run, by its place."""
    if not folder.name.startswith("seed_") or len(folder.parts) < 4:
        return "unknown"
    system, experiment, setting, seed = folder.parts[-4:]
    words = f"system={system} experiment={experiment} setting={setting} seed={seed.removeprefix('seed_')}"
    return f"python scripts/ablation.py {words} train.episodes={load_config(folder).train.episodes}"


if __name__ == "__main__":
    main()
