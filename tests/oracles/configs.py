"""Configurations that a command composes of its words."""

from dataclasses import fields
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import OmegaConf

from dynasindy.dyna.experiment import Recipe

CONF = Path(__file__).resolve().parents[2] / "conf"


def composed(command, *words):
    """Return the configuration of a command, whose folder is `run` where none is given."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose(command, list(words))
    if "folder" in cfg and OmegaConf.is_interpolation(cfg, "folder"):
        cfg.folder = "run"
    return cfg


def make_parts(cfg):
    """Return the parts of a run of a configuration, whose scenario can be built, too."""
    names = {f.name for f in fields(Recipe)} - {"seed", "device"}
    parts = {name: instantiate(cfg[name], _convert_="all") for name in names}
    instantiate(cfg.scenario, _convert_="all")
    return Recipe(**parts, seed=cfg.seed).build()
