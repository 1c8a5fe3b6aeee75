"""Configurations that a command composes of its words."""

from pathlib import Path

from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

CONF = Path(__file__).resolve().parents[2] / "conf"


def composed(command, *words):
    """Return the configuration of a command, whose folder is `run` where none is given."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose(command, list(words))
    if "folder" in cfg and OmegaConf.is_interpolation(cfg, "folder"):
        cfg.folder = "run"
    return cfg
