"""Evaluate a policy: `python scripts/evaluate.py run=PATH 'scenarios=[step,sine,wind]' [animate=true]`."""

import os
from pathlib import Path

os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")

import hydra
import torch
from command import one_line_errors
from omegaconf import DictConfig
from saved_run import load_config, load_policy, load_scenario

from dynasindy.evaluation.files import save_evaluation
from dynasindy.evaluation.scenarios import evaluate
from dynasindy.evaluation.summary import summarise, to_text
from dynasindy.viz.animation import animate
from dynasindy.viz.evaluation import draw_evaluation


@hydra.main(version_base="1.3", config_path="../conf", config_name="evaluate")
def main(cfg: DictConfig) -> None:
    """Run the policy in each scenario, print its table and write its figures."""
    torch.set_num_threads(cfg.threads)
    if cfg.run is None:
        raise ValueError("run is not given; give run=PATH, a run folder that train.py printed")
    folder = Path(cfg.run)
    config = load_config(folder)
    env, policy = load_policy(config, folder)
    scenarios = [load_scenario(name, config) for name in cfg.scenarios]
    for scenario in scenarios:
        result = evaluate(env, policy, scenario)
        save_evaluation(result, folder / "evaluation")
        draw_evaluation(result, folder / "evaluation", formats=cfg.formats)
        if cfg.animate:
            animate(result, folder / "evaluation" / f"{scenario.name}.{cfg.animation}")
        print(
            to_text(summarise(result), f"Scenario '{scenario.name}' ({scenario.episodes} references)"),
            end="\n\n",
        )
    print(f"Figures, tables and trajectories: {folder / 'evaluation'}")


if __name__ == "__main__":
    one_line_errors(main)
