"""Fly a rig: `python scripts/rig.py system=tras rig=udp rig.host=ADDRESS`; without `rig=`, a simulated one."""

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from command import command
from hydra.utils import instantiate
from omegaconf import DictConfig

from dynasindy import load
from dynasindy.dyna.stopped import Stopped
from dynasindy.rig import Wiring
from dynasindy.rig.session import Knowledge, Session


@command("rig")
def main(cfg: DictConfig) -> None:
    """Excite, identify, plan while the rig rests, fly; or fly a controller that is there."""
    torch.set_num_threads(cfg.threads)
    system, sensors, guard = (instantiate(cfg[name], _convert_="all") for name in ("system", "sensors", "guard"))
    seen = tuple(name in sensors.channels for name in system.signature.state_names) if sensors else None
    wiring = Wiring(system.signature, seen or (True,) * system.signature.n_x, cfg.dt)
    plant = instantiate(cfg.plant, _convert_="all")
    wanted = flown_targets(cfg, plant)
    ends = zip(plant["outputs"], plant["low"], plant["high"], strict=True)
    targets = {name: (low, high) for name, low, high in ends}
    if not guard.low and not guard.high:
        guard = replace(guard, **within(plant.get("bounds") or {}, wiring))
    knowledge = Knowledge(plant["library"], plant["known"], targets, planning=dict(cfg.planner))
    given = load(cfg.controller) if cfg.controller else None
    with instantiate(cfg.rig, _convert_="all")(system=system, dt=cfg.dt) as rig:
        session = Session(rig, wiring, guard, Path(cfg.folder), tell=partial(print, flush=True))
        try:
            if given is None:
                session.excite(instantiate(cfg.excitation, _convert_="all")(n_u=system.signature.n_u, dt=cfg.dt))
            for _ in range(cfg.flights):
                if not session.failed:
                    session.fly(given or session.learn(knowledge, cfg.seed), wanted, cfg.seconds)
        except KeyboardInterrupt as stop:
            words = f"stopped; the rig was asked for its safe input, its logs are in {cfg.folder}"
            raise Stopped(words, getattr(stop, "signal", 2)) from stop
    print(f"Logs, model and controller: {cfg.folder}")
    if session.failed:
        sys.exit(1)


def flown_targets(cfg: DictConfig, plant: dict[str, Any]) -> list[list[float]]:
    """Return the targets to hold, before anything moves.

    Raises:
        ValueError: One is not of this plant, or outside of its box, or nothing would be flown.
    """
    low, high, names = plant["low"], plant["high"], plant["outputs"]
    if not cfg.seconds > 0 or cfg.flights < 1:
        raise ValueError(f"seconds={cfg.seconds}, flights={cfg.flights} fly nothing; give seconds > 0 and flights >= 1")
    if cfg.targets is None:
        return [[0.5 * a + 0.5 * b + 0.25 * sign * (b - a) for a, b in zip(low, high, strict=True)] for sign in (1, -1)]
    for target in cfg.targets:
        inside = len(target) == len(names) and all(a <= v <= b for a, v, b in zip(low, target, high, strict=True))
        if not inside:
            raise ValueError(
                f"targets has {list(target)}; give one number for each of {', '.join(names)}, within plant.low={low} "
                f"and plant.high={high}"
            )
    return [[float(value) for value in target] for target in cfg.targets]


def within(bounds: dict[str, Any], wiring: Wiring) -> dict[str, dict[str, float]]:
    """Return the limits of the plant as ranges of its measured states; a single number is for both sides of zero."""
    seen = {name for name, known in zip(wiring.signature.state_names, wiring.seen, strict=True) if known}
    ends = {name: [-v, v] if isinstance(v, int | float) else v for name, v in bounds.items() if name in seen}
    return {"low": {name: end[0] for name, end in ends.items()}, "high": {name: end[1] for name, end in ends.items()}}


if __name__ == "__main__":
    main()
