"""Runs of the main job: trained on a plant, planned from a log alone, and loaded again for their policy."""

import hashlib
import re
import shlex
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from cli import CONF, IN_CLONE, command_line, group_options, next_steps, program, run_steps, without
from command import compose, unknown_name
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from identify import load_data
from omegaconf import DictConfig, OmegaConf
from settings import check, plugins_of, read_config

from dynasindy.control import Observer, load, save
from dynasindy.control.controller import NAME
from dynasindy.control.period import suited_period
from dynasindy.dyna import Stopped
from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.recorder import Evaluating
from dynasindy.dyna.run import read_weights, result, run, run_report
from dynasindy.envs import Channel, ControlEnv, Sensors
from dynasindy.evaluation.check import thin_margin
from dynasindy.evaluation.scenarios import Policy, Scenario
from dynasindy.evaluation.tracking_criteria import WITHIN
from dynasindy.findings import Finding, note, records
from dynasindy.identification.identify import before_fit
from dynasindy.identification.log_fit import fit_log
from dynasindy.identification.recording_diagnostics import low_signal_findings
from dynasindy.identification.source import PERIOD, Source, closest_period, rates_of
from dynasindy.identification.targets import targets_like
from dynasindy.planning import GradientPlanning
from dynasindy.planning.gradient_planning import ACCEPTABLE_ERROR, LONGEST
from dynasindy.progress import say
from dynasindy.safe_io import output_folder, read_json, reading, write_json, write_text
from dynasindy.sentences import command_word, lines
from dynasindy.sindy import Oracle, SindyModel
from dynasindy.workbench import damped, forecast, log_report, plan, refit_shortage, targets_far_off


def train_on_plant(cfg: DictConfig, swept: bool) -> bool:
    """Run the experiment of a config, unless it has ended before, draw its figures and print what came of it.

    Returns:
        Whether it is as good as the config wants it to be.
    """
    job = HydraConfig.get()
    if cfg.resume is not None:
        # The run's own settings, in the folder where it is now.
        own = ("resume", "finish", "threads", "plugins", "device")
        if others := [word for word in job.overrides.task if word.partition("=")[0] not in own]:
            raise ValueError(f"resume={cfg.resume} goes on with the run's own settings; leave out {' '.join(others)}")
        folder, saved = Path(cfg.resume), load_config(Path(cfg.resume), cfg.plugins)
        ended = (folder / "metrics.json").is_file() and not (folder / "checkpoints").is_dir()
        if ended and result(folder, saved.train.episodes) is None:
            raise ValueError(f"{folder} holds results and no checkpoint to resume; give the folder of a stopped run")
        new = {"folder": str(folder.absolute()), **{name: cfg[name] for name in own if name != "plugins"}}
        cfg = DictConfig({**saved, **new})
    if cfg.system is None:
        instead = f"choose another, or fit a model to the log: {program('identify')} data=csv data.path=FILE"
        raise ValueError(f"system={job.runtime.choices.system} is no plant to train on, only a log of one; {instead}")
    folder, begun = Path(cfg.folder), cfg.copy()
    begun.resume, begun.finish = None, False  # a run that is resumed before its first checkpoint writes them anew
    config = OmegaConf.to_yaml(begun, resolve=True)  # before anything is built, which names what is not given less well
    names = [field.name for field in fields(Recipe) if field.name not in ("seed", "device")]
    parts = {name: instantiate(cfg.get(name), _convert_="all") for name in names}
    recipe = Recipe(**parts, seed=cfg.seed, device=cfg.get("device", "cpu"))
    scenario, within = instantiate(cfg.scenario, _convert_="all"), cfg.evaluation.get("within", WITHIN)
    evaluating = Evaluating(scenario, cfg.evaluation.every, within, cfg.get("tensorboard", False))
    print(f"Run folder: {folder}", flush=True)
    done = result(folder, recipe.train.episodes) is not None
    kept = cfg.checkpoint.every, shlex.join([*program("train").split(), *plugins_of(cfg)])
    metrics = run(recipe, evaluating, folder, config, command_and_commit(job), *kept, cfg.finish)
    drawn = any((folder / "figures").glob("step_response.*"))  # the last figure; a job may have been stopped before it
    if swept and ("level" in cfg or (done and drawn)):  # of an ablation its table tells
        print(f"finished before: {folder}" if done else f"finished: {folder}, {metrics['cost']['wall_seconds']:.0f} s")
        return True
    from dynasindy.viz.run import draw_run  # Matplotlib, when there is something to draw

    draw_run(folder, recipe.system.signature, tuple(cfg.get("formats", ("png",))))
    say(run_report(metrics, folder))
    controlled = metrics["verdict"].get("controlled") is not False
    written = (folder / NAME).is_file()  # a task without targets leaves no controller to check or to export
    if controlled and not swept:
        flown = run_steps(folder, "evaluate", plugins=plugins_of(cfg))
        say(next_steps(*flown, *(run_steps(folder, "check", "export") if written else ())))
    elif not swept:
        lacking, words = "model.unexplained" in [f["code"] for f in metrics["findings"]], job.overrides.task
        error = metrics["imagined_error"] or 0.0
        longer = f"plans longer: errors in the model are {100 * error:.2g} %" if error > ACCEPTABLE_ERROR else ""
        if longer and (window := metrics["planning"]["window"]) > LONGEST:  # it was made longer
            words = [*without(words, "planning.window"), f"planning.window={window}"]
        say(improvements(folder, words, recipe.train.episodes, written, longer, lacking))
    good = metrics["verdict"]["usable"] or not cfg.evaluation.must_improve
    return good and (controlled or not cfg.evaluation.get("must_control"))


def improvements(
    run: object,
    words: Sequence[str],
    episodes: int | None = None,
    checked: bool = True,
    longer: str = "",
    lacking: bool = False,
) -> str:
    """Return what helps where the plant is not controlled: where the loop is weak, and more or better data.

    A plan from a log has no real `episodes`; `longer` is what a longer plan does, if it may help. Of a model that is
    `lacking` something a check tells nothing, and more episodes mend none.
    """
    steps, resumed = [], any(word.startswith("resume=") for word in words)
    if checked and not lacking:
        steps.append(command_line("check", [f"run={run}"], "tells at which targets the loop is weak, and how"))
    tried = longer and any(word.startswith("planning.updates=") for word in words)
    if (longer or episodes is not None) and not (resumed or lacking or tried):
        key, value = ("planning.updates", 3000) if longer else ("train.episodes", max(3, 2 * (episodes or 0)))
        does = longer or "flies more episodes, whose data mend the model"
        kept = [word for word in words if not re.fullmatch("experiment=.*smoke", word)]  # which learns too little
        steps.append(command_line("train", [*without(kept, key, "folder", "finish"), f"{key}={value}"], does))
    logged = episodes is None and not longer and any(word.startswith("data.path=") for word in words)
    if logged or (lacking and not resumed):
        identifying = ["system", "data", "plant", "world_model", "refinement", "source", "longest_delay", "threads"]
        own = without(words, *identifying)
        lacks = "the log lacks: what to record, or which functions" if logged else "the library lacks"
        steps.append(command_line("identify", [word for word in words if word not in own], f"tells what {lacks}"))
    return next_steps(*steps)


def command_and_commit(job: DictConfig) -> dict[str, str]:
    """Return the command line of a job and the commit of the code, "unknown" outside a git checkout.

    An installed package is in none, though it may lie in one of the user's.
    """
    commit, git = "", ["git", "-C", str(CONF.parent), "describe", "--always", "--dirty", "--exclude", "*"]
    if IN_CLONE and shutil.which("git"):
        commit = subprocess.run(git, capture_output=True, text=True).stdout.strip()
    return {"command": " ".join([program(job.job.config_name), *job.overrides.task]), "commit": commit or "unknown"}


def prepare(cfg: DictConfig) -> tuple[dict[str, Any], Source | None, SindyModel, dict[str, Any], list[Finding]]:
    """Read the log of a config and build the parts of a plan; what cannot be is refused before the fit.

    Returns:
        Settings of the planning, the log, its model, what a plan is made of by group, and what was found.
    """
    if (device := cfg.get("device", "cpu")) != "cpu":
        raise ValueError(f"device is {device}; allowed is cpu where a log or a model is planned on: leave it out")
    if cfg.get("data") is None and cfg.system is not None:
        raise ValueError("model=PATH plans without a plant, and system names one; leave system out")
    source = None if cfg.get("data") is None else load_data(cfg)
    targets = {key: cfg.plant.get(key) for key in ("outputs", "low", "high")}
    if lacking := [name for name, value in targets.items() if value is None]:
        like: dict[str, list[str]] = {"outputs": ["angle"], "low": ["-0.5"], "high": ["0.5"]}
        if source is not None and targets["outputs"] is not None:  # where most of its samples lie
            for name in targets["outputs"]:
                source.signature.state_index(str(name))  # which says what there is instead of an unknown one
            like = targets_like(source, (), targets) or like
        words = " ".join(command_word(f"plant.{name}", values) for name, values in like.items())
        raise ValueError(f"plant.{lacking[0]} is not given; say what is to be tracked within which targets, as {words}")
    build = instantiate(cfg.planning, _convert_="all")
    if not isinstance(build, partial) or build.func is not GradientPlanning:
        raise ValueError("without a plant a policy is planned through the model's gradient; leave planning=gradient")
    planning = {name: value for name, value in build.keywords.items() if name != "every"}
    names = ("task", "sensors", "world_model", "scenario")
    parts = {name: instantiate(cfg.get(name), _convert_="all") for name in names}
    given = source is None or cfg.model is not None  # it has its own library
    model = SindyModel.load(str(cfg.model)) if given else parts["world_model"](signature=source.signature)
    parts["task"](signature=model.signature)
    if source is None:
        return planning, None, model, parts, []
    if given:
        source.with_states_of(model)  # refuses a model of another plant
    others = [i for i, name in enumerate(source.signature.state_names) if name not in cfg.plant.outputs]
    return planning, source, model, parts, low_signal_findings(source.training, source.signature, others)


def plan_from_log(cfg: DictConfig, swept: bool) -> bool:
    """Identify, plan and forecast without a plant, write the folder, and print what came of it.

    Returns:
        Whether it is as good as the config wants it to be.
    """
    planning, source, model, parts, findings = prepare(cfg)
    folder, words, read = Path(cfg.folder), HydraConfig.get().overrides.task, _digests(cfg)
    figures = output_folder(folder, "figures")
    if swept and _finished(folder, read):
        say(f"finished before: {folder}")
        return True
    say(f"Run folder: {folder}", *lines(findings))
    if source is not None and cfg.model is None:
        if before := before_fit(model, source):
            say(*lines(before))
        fitted = fit_log(model, source)
        say(fitted.report.to_text(), *(each.line("found") for each in fitted.content))
        model = fitted.model
    if "rates" not in cfg.plant:  # nor where they are to be given
        OmegaConf.update(cfg, "plant.rates", damped(cfg.plant.outputs, rates_of(model)), force_add=True)
    task = instantiate(cfg.task, _convert_="all")(signature=model.signature)
    for name in ("metrics.json", NAME):  # of other settings
        (folder / name).unlink(missing_ok=True)
    write_json(folder / "origin.json", {**command_and_commit(HydraConfig.get()), "read": read})
    model.save(folder / "model.json")  # before the plan, which may fail
    dt, why = closest_period(source, cfg.env.dt), None
    if cfg.env.dt == PERIOD and not any(word.lstrip("+").startswith("env.dt=") for word in words):
        dt, why = suited_period(model, task, source)
    elif source is not None and dt != cfg.env.dt:
        why = note("control.sampled", seconds=dt, wanted=cfg.env.dt, step=source.training.dt)
    say(*lines(filter(None, [why, refit_shortage(model, source), *targets_far_off(model, task, source)])))
    OmegaConf.update(cfg, "env.dt", dt)
    write_text(folder / "config.yaml", OmegaConf.to_yaml(cfg, resolve=True))
    try:
        controller = plan(model, task, source, parts["sensors"], dt, cfg.seed, **planning)
        save(controller, folder / NAME)  # before the forecast, which may fail
        scenario = replace(parts["scenario"], seconds=None, lengths=1.0)  # as long as the task's episodes
        prediction = forecast(controller, model, source, scenario, cfg.evaluation.get("within", WITHIN))
    except (KeyboardInterrupt, Exception) as stop:
        if (folder / NAME).is_file():
            say(f"Controller: {folder / NAME}, of which nothing is promised")
        if not isinstance(stop, KeyboardInterrupt):
            raise
        again = command_line("train", [*without(words, "model"), command_word("model", str(folder / "model.json"))])
        line = f"stopped; the equations are kept, plan on them without a new fit: {again}"
        raise Stopped(line, getattr(stop, "signal", 2)) from stop
    thin = thin_margin(controller, model) if prediction.controlled else ()
    metrics = {"prediction": prediction.record(), "findings": records(thin), "equations": model.equations()}
    if flown := prediction.evaluation:
        from dynasindy.viz.response import draw_evaluation

        draw_evaluation(flown, figures, formats=tuple(cfg.formats), place=prediction.place)
    write_json(folder / "metrics.json", {"seed": cfg.seed, **metrics})  # last, for in a sweep it says that all is done
    say(log_report(model, prediction), *lines(thin), f"Controller: {folder / NAME}", *model.signature.own_inputs())
    if not swept:
        longer = "plans longer" if "forecast.longer_plan" in [each.code for each in prediction.findings] else ""
        helps = improvements(folder, words, longer=longer, lacking=bool(prediction.doubts))
        say(next_steps(*run_steps(folder, "check", "export")) if prediction.controlled else helps)
    return prediction.controlled or not cfg.evaluation.get("must_control")


def _digests(cfg: DictConfig) -> dict[str, str]:
    """Return the SHA-256 of the settings and of what is read: a log that was recorded anew has the same name."""
    logs = OmegaConf.select(cfg, "data.path", default=None)
    files = (cfg.model, *([logs] if isinstance(logs, str) else logs or ()))
    texts = {"settings": OmegaConf.to_yaml(cfg, resolve=True).encode()}
    texts |= {str(file): Path(file).read_bytes() for file in files if file and Path(file).is_file()}
    return {name: hashlib.sha256(text).hexdigest() for name, text in texts.items()}


def _finished(folder: Path, read: Mapping[str, str]) -> bool:
    """Return whether a folder holds a finished job of the same settings and files."""
    with suppress(OSError, KeyError, ValueError):
        same = read_json(folder / "origin.json")["read"] == read
        return same and "controlled" in read_json(folder / "metrics.json")["prediction"]
    return False


def load_config(folder: Path, plugins: Sequence[str] = ()) -> DictConfig:
    """Return the resolved configuration of a run, of which nothing but parts of dynasindy and plug-ins can be built.

    The folder may be anybody's.
    """
    file = folder / "config.yaml"
    if not file.is_file():
        lacks = "is no run folder, it has no config.yaml" if folder.is_dir() else "does not exist"
        raise FileNotFoundError(f"{folder} {lacks}; give a run folder that train.py printed")
    config = read_config(file)
    if any(config.get(key) is not None for key in ("rig", "data", "model")):
        told = f"{program('check')} run={folder} tells what its controller does on the model"
        raise ValueError(f"{folder} is of a rig, a log or a model, so there is no simulated plant to fly; {told}")
    check(config, str(file), plugins)
    return config


def load_policy(config: DictConfig, folder: Path) -> tuple[ControlEnv, Policy]:
    """Return the real environment of a run and its deployed policy."""
    system = instantiate(config.system)
    task = instantiate(config.task, _convert_="all")(signature=system.signature)
    env = instantiate(config.env)(system=system, task=task)
    if not (folder / "policy.pt").is_file():
        if (folder / NAME).is_file():
            return env, load(folder).policy  # a controller that was handed on without the files of its training
        goes_on = f"go on with {program('train')} resume={folder}, or end it with finish=true beside it"
        raise FileNotFoundError(f"{folder} has no policy.pt, its run did not end; {goes_on}")
    policy = instantiate(config.agent, _convert_="all")(n_obs=task.n_o, n_u=system.signature.n_u).deployed
    policy.load_state_dict(read_weights(folder / "policy.pt", policy.state_dict()))
    return env, policy


def load_observer(config: DictConfig, folder: Path, env: ControlEnv) -> Observer | None:
    """Return the observer by which the policy of a run sees the plant, None if it sees all states."""
    file, sensors = folder / "observer.json", instantiate(config.get("sensors"), _convert_="all")
    if sensors is None and not file.is_file():
        return None
    # Without sensors a delay was found, for which an observer makes up.
    sensors = sensors or Sensors(dict.fromkeys(env.system.signature.state_names, Channel()))
    model = instantiate(config.world_model, _convert_="all")(signature=env.system.signature)
    if not isinstance(model, Oracle):
        model = SindyModel.load(folder / "model.json")
    observer, record = Observer(model, sensors, env), read_json(file)
    with reading(file):
        observer.load_state_dict(record)
    return observer


def load_scenario(name: str, config: DictConfig, env: ControlEnv) -> Scenario:
    """Return a scenario for the plant of a run, by its name in `scenario` of conf/ or of a folder of the user's own.

    It may copy episodes and control period of the run's environment.
    """
    if name not in (names := group_options("scenario")):
        raise ValueError(unknown_name(name, names, "scenario"))
    place = {"task": {"max_steps": env.task.max_steps}, "env": {"dt": env.dt}, "plant": config.plant}
    merged: Any = OmegaConf.merge(place, OmegaConf.to_container(compose(None, [f"+scenario={name}"])))
    check(merged)
    scenario: Scenario = instantiate(merged.scenario, _convert_="all")
    own = OmegaConf.select(config, "scenario.seconds")
    # A run that was judged in short flights is flown in short ones, unless a scenario has its disturbance later.
    if own and own < scenario.length(env) and not scenario.windows:
        scenario = replace(scenario, seconds=own)
    return scenario
