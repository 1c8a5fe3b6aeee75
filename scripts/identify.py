"""Identify a model: `python scripts/identify.py [system=xi] [data=csv data.path=log.csv]`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cli import command

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from dynasindy.identification.identify import Identified
    from dynasindy.identification.source import Source


@command("identify")
def main(cfg: DictConfig) -> None:
    """Load data, fit, judge, write everything and print it."""
    import torch
    from hydra.core.hydra_config import HydraConfig
    from hydra.utils import instantiate
    from logged import loaded
    from next_steps import listed, with_ends

    from dynasindy.identification.before_fit import before_fit, plants_with
    from dynasindy.identification.identify import identify_source
    from dynasindy.identification.report import to_words, write_identification
    from dynasindy.progress import report_progress, say, width
    from dynasindy.sentences import lines

    torch.set_num_threads(cfg.threads)
    if cfg.data.get("path") and cfg.get("sensors") is not None:
        raise ValueError(
            f"sensors={HydraConfig.get().runtime.choices.sensors} makes a simulated plant measured, and data.path is a "
            "log, which holds what its sensors gave; leave sensors out"
        )
    if (system := instantiate(cfg.system, _convert_="all")) is not None and not cfg.data.get("path"):
        # refuses functions before the plant moves
        instantiate(cfg.world_model, _convert_="all")(signature=system.signature)
    report_progress("data")
    source, added = loaded(cfg)
    model, folder = instantiate(cfg.world_model, _convert_="all")(signature=source.signature), Path(cfg.folder)
    before = before_fit(model, source)
    findings = [*added, *before.findings]
    say(*lines(findings))
    found = identify_source(model, source, cfg.horizons)
    known = plants_with(source.signature) if source.logged and system is None else []
    source = found.source
    write_identification(found, source, folder, findings)
    draw(found, source, folder, list(cfg.formats))
    steps = [following(cfg, found, known, before.missing.certain if found.predicts else before.missing.possible)]
    steps += [with_ends(HydraConfig.get().overrides.task, source.ends)] if source.ends else []
    say(to_words(found, source, width()), f"written to {folder}", listed(*steps))


def following(cfg: DictConfig, found: Identified, known: Sequence[str], rates: Mapping[str, str]) -> str:
    """Return the command that comes next, which holds all that was given, and what comes of it.

    Args:
        cfg: The settings.
        found: What was identified.
        known: Plants that are known by name and have the columns of the log.
        rates: Rate of each state, known or lacking.
    """
    if found.quiet and not found.predicts:
        return "a log in which the inputs move further, by the same command; this one tells too little to plan on"
    from hydra.core.hydra_config import HydraConfig
    from next_steps import planning, with_plant, with_rates
    from omegaconf import OmegaConf

    from dynasindy.identification.period import closest_period
    from dynasindy.identification.targets import targets_like

    job, logged, told = HydraConfig.get(), found.source.logged, cfg.plant.get("known") or {}
    words, system = job.overrides.task, job.runtime.choices.system
    if known and not found.predicts:
        others = f"; others with these columns: {', '.join(known[1:])}" if known[1:] else ""
        return f"{with_plant(words, known[0])}  # takes the functions of that plant{others}"
    if set(rates) - set(told):
        return f"{with_rates(words, rates)}  # identifies again, with the rates that the log lacks"
    does = "plans a controller on the log" if logged else "excites, identifies and plans in one go"
    keys = ("outputs", "low", "high")
    given = {key: None if OmegaConf.is_missing(cfg.plant, key) else cfg.plant[key] for key in keys}
    period = closest_period(found.source)
    if targets := targets_like(found.source, rates.values(), given, found.model, period):
        units = dict(zip(found.source.signature.state_names, found.source.signature.state_units, strict=True))
        named = [str(name) for name in given["outputs"] or targets["outputs"]]
        asked = ", ".join(f"{name} in {units[name]}" for name in named if units.get(name, "-") != "-")
        does += "; put in its targets what you want to hold, within which limits" + (asked and f", {asked}")
    if found.forecasts is not None and not found.predicts:
        does += "; this model does not predict, so mend first what is said above"
    return f"{planning(words, logged, system, targets)}  # {does}"


def draw(found: Identified, source: Source, folder: Path, formats: list[str]) -> None:
    """Draw the training data and the open-loop prediction against the real states."""
    import torch

    from dynasindy.identification.report import describe_restarts
    from dynasindy.viz.identification import prediction, training_data
    from dynasindy.viz.style import save_figures

    training, validation = source.training, source.validation
    shown, against = ("log", "the log") if source.logged else ("plant", "the plant")
    figures = {
        "training_data": training_data(
            torch.arange(len(training)) * training.dt,
            training.x,
            training.u,
            source.signature,
            segment=training.segment,
        ),
        "prediction": prediction(
            torch.arange(len(validation)) * validation.dt,
            validation.x_next,
            found.predicted,
            source.signature,
            f"Free-running prediction of data that the fit did not see{describe_restarts(validation)}, "
            f"against {against}",
            validation.segment,
            shown,
        ),
    }
    save_figures(figures, folder, formats)


if __name__ == "__main__":
    main()
