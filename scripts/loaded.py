"""The data that a command is given, with the rates that a log shows to be missing."""

from typing import TYPE_CHECKING

from hydra.utils import instantiate
from omegaconf import DictConfig

if TYPE_CHECKING:
    from dynasindy.evaluation.source import Source


def loaded(cfg: DictConfig) -> tuple["Source", list[str]]:
    """Return the data of a config, and what is told of them, in lines.

    Where nobody knows the equations, rates that a log lacks become states, and equations that are known, in
    `plant.known`.

    Args:
        cfg: The settings. `plant.known` is written into them where nobody gave it.
    """
    from dynasindy.evaluation.before_fit import with_missing_rates

    data, system, excitation = (instantiate(cfg[name], _convert_="all") for name in ("data", "system", "excitation"))
    source = data.load(system, excitation)
    named = system is not None and system.known
    if named or cfg.get("model") is not None or cfg.plant.get("known") is not None:
        return source, []
    build = instantiate(cfg.world_model, _convert_="all")
    source, cfg.plant.known, told = with_missing_rates(build, source, None)
    return source, told
