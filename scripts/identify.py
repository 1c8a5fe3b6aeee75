"""Identify a model: `python scripts/identify.py [system=xi] [data=csv data.path=log.csv]`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from cli import command

if TYPE_CHECKING:
    from dynasindy.identification.identify import Identified
    from dynasindy.identification.source import Source


@command("identify")
def main(cfg: Any) -> None:
    """Load data, fit, judge, write everything and print it."""
    from hydra.core.hydra_config import HydraConfig
    from hydra.utils import instantiate
    from next_steps import next_steps

    from dynasindy.identification.identify import (
        before_fit,
        identify_source,
        to_words,
        write_identification,
    )
    from dynasindy.progress import report_progress, say, width
    from dynasindy.sentences import lines

    if cfg.data.get("path") and cfg.get("sensors") is not None:
        raise ValueError(
            f"sensors={HydraConfig.get().runtime.choices.sensors} makes a simulated plant measured, and data.path is a "
            "log, which holds what its sensors gave; leave sensors out"
        )
    if (system := instantiate(cfg.system, _convert_="all")) is not None and not cfg.data.get("path"):
        # refuses functions before the plant moves
        instantiate(cfg.world_model, _convert_="all")(signature=system.signature)
    report_progress("data")
    source = load_data(cfg)
    model, folder = instantiate(cfg.world_model, _convert_="all")(signature=source.signature), Path(cfg.folder)
    findings = before_fit(model, source)
    say(*lines(findings))
    found = identify_source(model, source)
    source = found.source
    write_identification(found, source, folder, findings)
    if cfg.formats:
        draw(found, source, folder, list(cfg.formats))
    # Of a log that tells too little to plan on, the findings say how to log anew.
    steps = [] if found.quiet and not found.predicts else [next_steps(next_command(cfg, found))]
    say(to_words(found, source, width()), f"written to {folder}", *steps)


def load_data(cfg: Any) -> Source:
    """Return the data of a config."""
    from hydra.utils import instantiate

    from dynasindy.identification.identify import LoggedData

    data, system = (instantiate(cfg[name], _convert_="all") for name in ("data", "system"))
    excitation = None if isinstance(data, LoggedData) else instantiate(cfg.excitation, _convert_="all")
    source: Source = data.load(system, excitation)
    return source


def next_command(cfg: Any, found: Identified) -> str:
    """Return the command that plans, with all that was given, and what comes of it."""
    from hydra.core.hydra_config import HydraConfig
    from next_steps import command_line, without
    from omegaconf import OmegaConf

    from dynasindy.identification.source import closest_period, rates_of
    from dynasindy.identification.targets import targets_like
    from dynasindy.sentences import command_word

    source, job = found.source, HydraConfig.get()
    does = "plans a controller on the log" if source.logged else "excites, identifies and plans in one go"
    keys = ("outputs", "low", "high")
    given = {key: None if OmegaConf.is_missing(cfg.plant, key) else cfg.plant[key] for key in keys}
    targets = targets_like(source, rates_of(found.model).values(), given, found.model, closest_period(source))
    if targets:
        does += "; put in its targets what you want to hold, within which limits, in the units of the states"
    if found.forecasts is not None and not found.predicts:
        does += "; this model does not predict, so mend first what is said above"
    of_data = () if source.logged else ("data", "refinement", "source")  # what is said of simulated data
    plan = without(job.overrides.task, "folder", "hydra", "formats", *of_data)
    system = job.runtime.choices.system
    if not source.logged and system and not any(word.lstrip("+~").startswith("system=") for word in plan):
        plan.insert(0, f"system={system}")
    plan += [command_word(f"plant.{key}", values) for key, values in targets.items()]
    return command_line("train", plan, does)


def draw(found: Identified, source: Source, folder: Path, formats: list[str]) -> None:
    """Draw the training data and the open-loop prediction against the real states."""
    import torch

    from dynasindy.identification.identify import describe_restarts
    from dynasindy.viz.identification import prediction, training_data
    from dynasindy.viz.style import save_figures

    training, validation = source.training, source.validation
    shown, against = ("log", "the log") if source.logged else ("plant", "the plant")
    title = (
        f"Free-running prediction of data that the fit did not see{describe_restarts(validation)}, against {against}"
    )
    (t, later), names = (torch.arange(len(data)) * data.dt for data in (training, validation)), source.signature
    real, predicted, segment = validation.x_next, found.predicted, validation.segment
    figures = {
        "training_data": training_data(t, training.x, training.u, names, segment=training.segment),
        "prediction": prediction(later, real, predicted, names, title, segment, shown),
    }
    save_figures(figures, folder, formats)


if __name__ == "__main__":
    main()
