"""From a log to a controller: what `train.py data=csv` and `train.py model=PATH` do, without a plant."""

import hashlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from hydra.utils import instantiate
from identify import given_targets, load_data
from next_steps import command_line, improvements, next_steps, run_steps, without
from omegaconf import DictConfig, OmegaConf
from saved_run import command_and_commit

from dynasindy.control import save
from dynasindy.control.files import NAME
from dynasindy.control.period import suited_period
from dynasindy.dyna import Stopped
from dynasindy.evaluation.tracking_criteria import WITHIN
from dynasindy.findings import Finding, note
from dynasindy.identification.recording_diagnostics import low_signal_findings
from dynasindy.identification.source import PERIOD, Source, closest_period, rates_of
from dynasindy.identification.targets import require_radians, targets_like
from dynasindy.planning import GradientPlanning
from dynasindy.progress import say
from dynasindy.safe_io import output_folder, read_json, write_json, write_text
from dynasindy.sentences import command_word, lines
from dynasindy.sindy import SindyModel
from dynasindy.viz.controllers import controller_name
from dynasindy.viz.response import draw_evaluation
from dynasindy.workbench import damped, forecast, log_report, model_of, plan, refit_shortage


def prepare(cfg: DictConfig) -> tuple[dict[str, Any], Source | None, dict[str, Any], list[Finding]]:
    """Read the log of a config and build the parts of a plan; what cannot be is refused before the fit.

    Returns:
        Settings of the planning, the log, what a plan is made of by group, and what was found.
    """
    if (device := cfg.get("device", "cpu")) != "cpu":
        raise ValueError(f"device is {device}; allowed is cpu where a log or a model is planned on: leave it out")
    logged = cfg.get("data") is not None
    if not logged and cfg.system is not None:
        raise ValueError("model=PATH plans without a plant, and system names one; leave system out")
    targets = given_targets(cfg)
    if lacking := [name for name, value in targets.items() if value is None]:
        like: dict[str, list[str]] = {"outputs": ["angle"], "low": ["-0.5"], "high": ["0.5"]}
        if logged and targets["outputs"] is not None:  # where most of its samples lie
            source = load_data(cfg)
            for name in targets["outputs"]:
                source.signature.state_index(str(name))  # which says what there is instead of an unknown one
            like = targets_like(source, (), targets) or like
        words = " ".join(command_word(f"plant.{name}", values) for name, values in like.items())
        what = "say what is to be tracked, and within which targets, such as"
        raise ValueError(f"plant.{lacking[0]} is not given; {what} {words}")
    build = instantiate(cfg.planning, _convert_="all")
    if not isinstance(build, partial) or build.func is not GradientPlanning:
        raise ValueError("without a plant a policy is planned through the model's gradient; leave planning=gradient")
    planning = {name: value for name, value in build.keywords.items() if name != "every"}
    source = load_data(cfg) if logged else None
    names = ("task", "sensors", "world_model", "scenario")
    parts = {name: instantiate(cfg.get(name), _convert_="all") for name in names}
    given = source is None or cfg.model is not None  # it has its own library
    model = SindyModel.load(str(cfg.model)) if given else parts["world_model"](signature=source.signature)
    parts["task"](signature=model.signature)
    if source is None:
        return planning, None, parts, []
    ends = {name: ends for name, *ends in zip(cfg.plant.outputs, cfg.plant.low, cfg.plant.high, strict=False)}
    others = [i for i, name in enumerate(source.signature.state_names) if name not in ends]
    require_radians(source, ends)
    return planning, source, parts, low_signal_findings(source.training, source.signature, others)


def plan_from_log(cfg: DictConfig) -> bool:
    """Identify, plan and forecast, write the folder, print what came of it, and return whether it is controlled."""
    planning, source, parts, findings = prepare(cfg)
    folder, settings = Path(cfg.folder), OmegaConf.to_yaml(cfg, resolve=True)
    figures = output_folder(folder, "figures")
    swept, words = HydraConfig.get().mode == RunMode.MULTIRUN, HydraConfig.get().overrides.task
    read = _digests(cfg)
    if swept and (before := _finished(folder, settings, read)) is not None:
        say(f"finished before: {folder}")
        return before
    say(f"Run folder: {folder}", *lines(findings))
    model = model_of(source, parts["world_model"], cfg.model)
    if "rates" not in cfg.plant:  # nor where they are to be given
        OmegaConf.update(cfg, "plant.rates", damped(cfg.plant.outputs, rates_of(model)), force_add=True)
    task = instantiate(cfg.task, _convert_="all")(signature=model.signature)
    for name in ("metrics.json", NAME):  # of other settings
        (folder / name).unlink(missing_ok=True)
    write_text(folder / "config.yaml", settings)  # before the plan, which may fail
    write_json(folder / "origin.json", {**command_and_commit(HydraConfig.get()), "read": read})
    model.save(folder / "model.json")
    if cfg.env.dt == PERIOD and not any(word.lstrip("+").startswith("env.dt=") for word in words):
        dt, why = suited_period(model, task, source)
    elif (dt := closest_period(source, cfg.env.dt)) == cfg.env.dt or source is None:
        why = None
    else:
        why = note("control.sampled", seconds=dt, wanted=cfg.env.dt, step=source.training.dt)
    say(*lines(filter(None, [why, refit_shortage(model, source)])))
    try:
        controller = plan(model, task, source, parts["sensors"], dt, cfg.seed, **planning)
        save(controller, folder / NAME)  # before the forecast, which may fail
        scenario = replace(parts["scenario"], seconds=None, lengths=1.0)  # as long as the task's episodes
        prediction = forecast(controller, model, source, scenario, cfg.seed, cfg.evaluation.get("within", WITHIN))
    except (KeyboardInterrupt, Exception) as stop:
        if (folder / NAME).is_file():
            say(f"Controller: {folder / NAME}, of which nothing is promised")
        if not isinstance(stop, KeyboardInterrupt):
            raise
        again = command_line("train", [*without(words, "model"), f"model={folder / 'model.json'}"])
        line = f"stopped; the equations are kept, plan on them without a new fit: {again}"
        raise Stopped(line, getattr(stop, "signal", 2)) from stop
    write_json(folder / "metrics.json", {"prediction": prediction.record(), "equations": model.equations()})
    if flown := prediction.evaluation:
        draw_evaluation(flown, figures, controller_name("gradient"), tuple(cfg.formats), prediction.place)
    say(log_report(model, prediction), f"Controller: {folder / NAME}", *model.signature.own_inputs())
    if not swept:
        steps = next_steps(*run_steps(folder, "check", "export"))
        say(steps if prediction.controlled else improvements(folder, words))
    return prediction.controlled


def _digests(cfg: DictConfig) -> dict[str, str]:
    """Return the SHA-256 of what is read: a log that was recorded anew has the same name."""
    logs = OmegaConf.select(cfg, "data.path", default=None)
    files = (cfg.model, *([logs] if isinstance(logs, str) else logs or ()))
    found = sorted(str(file) for file in files if file and Path(file).is_file())
    return {file: hashlib.sha256(Path(file).read_bytes()).hexdigest() for file in found}


def _finished(folder: Path, settings: str, read: Mapping[str, str]) -> bool | None:
    """Return whether a finished job of the same settings and files is controlled by its forecast, None without one."""
    with suppress(OSError, KeyError, ValueError):
        origin, metrics = (read_json(folder / f"{name}.json") for name in ("origin", "metrics"))
        if (folder / "config.yaml").read_text() == settings and origin["read"] == read:
            return bool(metrics["prediction"]["controlled"])
    return None
