"""What a run's config may name: every part of the groups, and no class that takes a file."""

import importlib
from pathlib import Path

from omegaconf import OmegaConf

REPOSITORY = Path(__file__).parents[2]


def test_no_admitted_class_takes_a_file(monkeypatch):
    monkeypatch.syspath_prepend(REPOSITORY / "scripts")
    import inspect
    import pkgutil

    import settings

    import dynasindy

    seen = 0
    for found in pkgutil.walk_packages(dynasindy.__path__, "dynasindy."):
        for part in vars(importlib.import_module(found.name)).values():
            if inspect.isclass(part) and part.__module__ == found.name and settings.is_part(part, "dynasindy"):
                seen += 1
                given = set(inspect.signature(part.__init__).parameters)
                assert not given & {"path", "file", "folder", "root", "command", "filename"}, part
    assert seen > 50


def test_every_part_of_the_groups_is_admitted(monkeypatch):
    monkeypatch.syspath_prepend(REPOSITORY / "scripts")
    from settings import require_trusted

    groups = ("system", "task", "excitation", "world_model", "agent", "planning", "scenario")
    for group in groups:
        for file in (REPOSITORY / "conf" / group).glob("[a-z]*.yaml"):
            if file.stem in ("logged", "black_box"):
                continue
            require_trusted(OmegaConf.to_container(OmegaConf.load(file)))
