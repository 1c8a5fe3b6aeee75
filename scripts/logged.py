"""From a log to a controller: what `train.py data=csv` and `train.py model=PATH` do, without a plant."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from job import command_and_commit
from omegaconf import DictConfig, OmegaConf

from dynasindy.control import save
from dynasindy.control.files import NAME
from dynasindy.data.csv import Recording
from dynasindy.evaluation.files import write_json, write_text
from dynasindy.evaluation.identification import Source, missing_rates
from dynasindy.evaluation.predicted import WITHIN, Prediction
from dynasindy.evaluation.summary import heading, summarise, to_text
from dynasindy.planning import GradientPlanning
from dynasindy.viz.evaluation import draw_evaluation
from dynasindy.workbench import foretell, plan
from dynasindy.world_models import SindyModel
from dynasindy.world_models.progress import Progress


def plan_from_log(cfg: DictConfig) -> Prediction:
    """Identify, plan and foretell, write the folder, and print what came of it.

    Raises:
        ValueError: The config does not say what is to be tracked, or how to plan from a log.
    """
    _require(cfg)
    torch.set_num_threads(cfg.threads)
    folder = Path(cfg.folder)
    print(f"Run folder: {folder}", flush=True)
    data = instantiate(cfg.get("data"), _convert_="all")
    source = None if data is None else data.load(instantiate(cfg.system), None)
    model = _model(cfg, source)
    _keep(cfg, model, folder)  # before the plan, which may fail
    task = instantiate(cfg.task, _convert_="all")(signature=model.signature)
    log = None if source is None else Recording(source.training, model.signature)
    settings = dict(instantiate(cfg.planning, _convert_="all").keywords)
    settings.pop("every", None)
    print("planning", flush=True)
    controller = plan(model, task, log, instantiate(cfg.sensors, _convert_="all"), cfg.env.dt, cfg.seed, **settings)
    scenario = replace(instantiate(cfg.scenario, _convert_="all"), seconds=None)
    unseen = None if source is None else source.validation
    prediction = foretell(controller, model, unseen, scenario, cfg.seed, cfg.evaluation.get("within", WITHIN))
    save(controller, folder / NAME)
    write_json(folder / "metrics.json", {"prediction": prediction.record(), "equations": model.equations()})
    print("\n".join(["", "Identified equations", *(f"  {line}" for line in model.equations()), ""]))
    if prediction.shown is not None:
        draw_evaluation(prediction.shown, folder / "figures")
        print(to_text(summarise(prediction.shown), f"{heading(prediction.shown)}, on a model"), end="\n\n")
    print(prediction.words())
    print(f"Controller: {folder / NAME}")
    return prediction


def _keep(cfg: DictConfig, model: SindyModel, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "config.yaml", OmegaConf.to_yaml(cfg, resolve=True))
    write_json(folder / "origin.json", command_and_commit(HydraConfig.get()))
    model.save(folder / "model.json")


def _require(cfg: DictConfig) -> None:
    if cfg.model is not None and cfg.get("data") is None and cfg.system is not None:
        raise ValueError(
            "model=PATH plans without a plant; give system=logged and plant.outputs, plant.low, plant.high"
        )
    if missing := [name for name in ("outputs", "low", "high") if OmegaConf.is_missing(cfg.plant, name)]:
        raise ValueError(
            f"plant.{missing[0]} is not given; say what is to be tracked, and within which targets, such as "
            "plant.outputs=[angle] plant.low=[-0.5] plant.high=[0.5]"
        )
    if not cfg.evaluation.get("within", WITHIN) > 0:
        raise ValueError(
            f"evaluation.within must be positive, got {cfg.evaluation.within}; give a share of the box of targets"
        )
    build = instantiate(cfg.planning)
    if not isinstance(build, partial) or build.func is not GradientPlanning:
        raise ValueError("without a plant a policy is planned through the model's gradient; leave planning=gradient")


def _model(cfg: DictConfig, source: Source | None) -> SindyModel:
    """Return the model of a file, or identify one.

    Raises:
        ValueError: The file is damaged or of another plant.
        TypeError: The world model is not sparse.
    """
    if cfg.model is not None:
        model = SindyModel.load(cfg.model)
        if source is not None and source.signature.state_names != model.signature.state_names:
            raise ValueError(
                f"{cfg.model} has the states {', '.join(model.signature.state_names)}, the log "
                f"{', '.join(source.signature.state_names)}; give a model of the plant that the log is of"
            )
        return model
    assert source is not None
    built = instantiate(cfg.world_model, _convert_="all")(signature=source.signature)
    if not isinstance(built, SindyModel):
        raise TypeError(f"world_model is a {type(built).__name__}, which no log is fitted by; leave world_model=sindy")
    with Progress():
        report = built.fit(source.training)
    print(report.to_text(), *missing_rates(built, source), sep="\n", flush=True)
    return built
