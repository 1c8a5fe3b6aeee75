"""What the scripts that train share: one run of Algorithm 1 from a composed config."""

import shlex
import subprocess
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch
from cli import CONF, IN_CLONE, called
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from saved_run import load_config
from settings import check
from trust import packages

from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.folder import result
from dynasindy.dyna.run import Evaluating, Provenance, Saving, run


@dataclass(frozen=True)
class Done:
    """What came of a job.

    Attributes:
        recipe: The experiment.
        metrics: What its `metrics.json` holds.
        before: Whether it had ended before.
        enough: Whether the policy is better than the untrained one and controls the plant, if it is to; or need not.
        trusting: Word of the command line that names the packages of the user's own parts; none where there are none.
    """

    recipe: Recipe
    metrics: dict[str, Any]
    before: bool
    enough: bool
    trusting: tuple[str, ...] = ()


def run_job(cfg: DictConfig, progress: bool = True) -> Done:
    """Build the experiment of a config and run it, unless it has ended before."""
    if not isinstance(cfg.threads, int) or cfg.threads < 1:
        raise ValueError(f"threads must be a whole number >= 1, got {cfg.threads}; 1 unless the cores are idle")
    if cfg.resume is not None:
        cfg = _resumed(cfg)
    provenance = Provenance(settings_of(cfg), command_and_commit(HydraConfig.get()))
    torch.set_num_threads(cfg.threads)
    names = [field.name for field in fields(Recipe) if field.name not in ("seed", "device")]
    parts = {name: instantiate(cfg.get(name), _convert_="all") for name in names}
    recipe = Recipe(**parts, seed=cfg.seed, device=cfg.get("device", "cpu"))
    evaluating = Evaluating(
        instantiate(cfg.scenario, _convert_="all"),
        cfg.evaluation.every,
        cfg.evaluation.get("within", 0.01),
        cfg.get("tensorboard", False),
    )
    if progress:
        print(f"Run folder: {cfg.folder}", flush=True)
    known = result(Path(cfg.folder), recipe.train.episodes) is not None
    own = packages(OmegaConf.to_container(cfg, resolve=True))
    trusting = (f"plugins=[{','.join(own)}]",) if own else ()
    saving = Saving(**cfg.checkpoint, again=" ".join([called("train"), *map(shlex.quote, trusting)]))
    metrics = run(recipe, evaluating, Path(cfg.folder), provenance, saving, progress, cfg.finish)
    usable = metrics["verdict"]["usable"] or not cfg.evaluation.must_improve
    controlled = metrics["verdict"].get("controlled") is not False or not cfg.evaluation.get("must_control", False)
    return Done(recipe, metrics, known, usable and controlled, trusting)


def _resumed(cfg: DictConfig) -> DictConfig:
    """Return the config of the run to resume, in the folder where it is now.

    Raises:
        ValueError: Other settings were given, which the run does not have.
    """
    own = ("resume=", "finish=", "threads=", "plugins=", "device=")
    if others := [word for word in HydraConfig.get().overrides.task if not word.startswith(own)]:
        raise ValueError(f"resume={cfg.resume} goes on with the run's own settings; leave out {' '.join(others)}")
    kept = load_config(Path(cfg.resume), cfg.plugins)
    check(kept, f"{cfg.resume}/config.yaml")
    folder = Path(cfg.resume)
    ended = (folder / "metrics.json").is_file() and not (folder / "checkpoints").is_dir()
    if ended and result(folder, kept.train.episodes) is None:
        raise ValueError(
            f"{folder} holds results and no checkpoint, it cannot go on and would begin anew; give the folder of a "
            "stopped run, or restore its files"
        )
    given = {name: cfg[name] for name in ("resume", "finish", "threads", "device")}
    return DictConfig({**kept, **given, "folder": str(Path(cfg.resume).absolute())})


def settings_of(cfg: DictConfig) -> str:
    """Return the resolved config as a run folder keeps it.

    Raises:
        ValueError: The config names no plant, only a log of one.
    """
    if cfg.system is None:
        given = HydraConfig.get().runtime.choices.system
        plants = sorted(
            file.stem for file in (CONF / "system").glob("[a-z]*.yaml") if file.stem not in (given, "black_box")
        )
        raise ValueError(
            f"system={given} is no plant to train on, only a log of one; choose one of {', '.join(plants)}, "
            f"or fit a model to the log: {called('identify')} data=csv data.path=FILE"
        )
    begun = cfg.copy()  # a run that is resumed before its first checkpoint writes them anew
    begun.resume, begun.finish = None, False
    return OmegaConf.to_yaml(begun, resolve=True)


def command_and_commit(job: DictConfig) -> dict[str, str]:
    """Return the command line of a job and the commit of the code, "unknown" outside a git checkout.

    An installed package is in none, though it may lie in one of the user's.
    """
    git = ["git", "-C", str(CONF.parent), "describe", "--always", "--dirty", "--exclude", "*"]
    try:
        commit = subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        commit = ""
    return {
        "command": " ".join([called(job.job.config_name), *job.overrides.task]),
        "commit": commit if IN_CLONE and commit else "unknown",
    }
