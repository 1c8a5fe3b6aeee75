"""Identify a model: `python scripts/identify.py [system=xi] [data=csv data.path=log.csv]`."""

from pathlib import Path
from typing import Any

from cli import command, command_line, next_steps, without


@command("identify")
def main(cfg: Any) -> None:
    """Load data, fit, judge, write everything and print it."""
    from hydra.utils import instantiate

    from dynasindy.identification.identify import Identified, before_fit
    from dynasindy.progress import report_progress, say
    from dynasindy.sentences import lines

    if cfg.data.get("path") and cfg.get("sensors") is not None:
        raise ValueError("sensors are those of a simulated plant, and data.path is a log; leave sensors out")
    build, folder = instantiate(cfg.world_model, _convert_="all"), Path(cfg.folder)
    if (system := instantiate(cfg.system, _convert_="all")) is not None and not cfg.data.get("path"):
        build(signature=system.signature)  # refuses functions before the plant moves
    report_progress("data")
    source = load_data(cfg)
    model = instantiate(cfg.world_model, _convert_="all")(signature=source.signature)
    findings = before_fit(model, source)
    say(*lines(findings))
    found = Identified.of(model, source)
    found.save(folder, findings)
    if cfg.formats:
        from dynasindy.viz.identification import draw_identification

        draw_identification(found, folder, cfg.formats)
    # Of a log that tells too little to plan on, the findings say how to log anew.
    steps = [] if found.quiet and not found.predicts else [next_steps(next_command(cfg, found))]
    say(found.to_text(), f"written to {folder}", *steps)


def load_data(cfg: Any) -> Any:
    """Return the data of a config: a log, or what its plant does under its excitation."""
    from hydra.utils import instantiate
    from omegaconf import OmegaConf

    data, system = (instantiate(cfg[name], _convert_="all") for name in ("data", "system"))
    source = data.load(system, None if cfg.data.get("path") else instantiate(cfg.excitation, _convert_="all"))
    library = OmegaConf.to_object(cfg.world_model).get("library")
    if source.logged and (rates := source.named_rates(library)):
        OmegaConf.update(cfg, "plant.known", rates, force_add=True)  # beside those that are known
        source = source.with_rates(rates)
    return source


def next_command(cfg: Any, found: Any) -> str:
    """Return the command that plans, with all that was given, and what comes of it."""
    from hydra.core.hydra_config import HydraConfig

    from dynasindy.identification.source import closest_period, rates_of
    from dynasindy.identification.targets import targets_like
    from dynasindy.sentences import command_word

    source, job, rates = found.source, HydraConfig.get(), rates_of(found.model)
    given = {key: cfg.plant.get(key) for key in ("outputs", "low", "high")}
    targets = targets_like(source, rates.values(), given, found.model, closest_period(source))
    mend = "mend first what is said above; this " if found.forecasts is not None and not found.predicts else ""
    of_data = () if source.logged else ("data", "refinement", "source")  # what is said of simulated data
    plan = without(job.overrides.task, "folder", "hydra", "formats", *of_data)
    plan += [command_word(f"plant.{key}", values) for key, values in targets.items()]
    plan += [command_word("model", str(Path(cfg.folder) / "model.json"))] if source.logged and not mend else []
    does = "plans a controller" if source.logged else "excites, identifies and plans in one go"
    does = "plans a controller for these targets, in the units of the states" if targets else does
    return command_line("train", plan, mend + does)


if __name__ == "__main__":
    main()
