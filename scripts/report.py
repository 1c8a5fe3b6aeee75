"""The paper's figures and tables beside ours: `python scripts/report.py [save=runs/ablation | save=RUN name=NAME]`."""

from pathlib import Path
from typing import Any

from cli import command


@command("report")
def main(cfg: Any) -> None:
    """Save runs if asked to, then build the report from all that is saved."""
    from omegaconf import OmegaConf
    from trust import read_config

    from dynasindy.progress import say
    from dynasindy.viz.report import Results, build

    results = Path(cfg.results)
    kept = [] if cfg.save is None else keep(cfg, results / "runs")
    configs = {file.parent.name: read_config(file) for file in sorted(results.glob("runs/*/config.yaml"))}
    if not configs and not any(results.glob("*.csv")):
        raise ValueError(
            f"{results} holds no saved run and no table, so there is nothing to report; give results=FOLDER, where "
            "they are, or save=RUN, which saves a run there first: a run folder, or runs/ablation"
        )
    settings = {name: OmegaConf.to_container(config) for name, config in configs.items()}
    saved = Results(results, settings)
    files = build(saved, Path(cfg.output))
    print(f"{files[0]}, from {len(settings)} saved run{'s' * (len(settings) != 1)}")
    for name in kept:
        if name not in saved.requested:
            read = ", ".join(sorted(saved.requested))
            say(f"note: no section of the report reads a run called {name}; it reads {read}")


def keep(cfg: Any, target: Path) -> list[str]:
    """Evaluate and save the runs that are asked for, and return the names of their copies."""
    from dynasindy.evaluation.saved import check_copy, keep_run, to_save

    runs = to_save(Path(cfg.save), cfg.name, cfg.seed, cfg.settings)
    for folder, name in runs.items():
        check_copy(folder, target / name, cfg.any_commit)
        measure(folder, cfg.scenarios, cfg.plugins)
        files = keep_run(folder, target / name, folder.parent.name not in cfg.slim, cfg.any_commit)
        print(f"saved {target / name}: {sum(file.stat().st_size for file in files) / 1000:.0f} kB")
    return list(runs.values())


def measure(folder: Path, scenarios: list[str], plugins: list[str]) -> None:
    """Evaluate a run in the scenarios in which it was not evaluated since it ended."""
    from saved_run import load_config, load_policy, load_scenario, load_sensing

    from dynasindy.evaluation.scenarios import evaluate
    from dynasindy.evaluation.summary import save_evaluation
    from dynasindy.safe_io import output_folder

    config, ended = load_config(folder, plugins), (folder / "metrics.json").stat().st_mtime
    out = output_folder(folder, "evaluation")
    files = {name: out / f"{name}.json" for name in scenarios}
    due = [name for name, file in files.items() if not file.is_file() or file.stat().st_mtime < ended]
    if due:
        env, policy = load_policy(config, folder)
        sensing = load_sensing(config, folder, env)
    for name in due:
        save_evaluation(evaluate(env, policy, load_scenario(name, config, env), sensing), out)


if __name__ == "__main__":
    main()
