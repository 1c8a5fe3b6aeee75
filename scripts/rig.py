"""Fly a rig: `python scripts/rig.py system=tras rig=udp rig.host=ADDRESS`; without `rig=`, a simulated one."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from command import command
from hydra.utils import instantiate
from omegaconf import DictConfig

from dynasindy import load
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
    ends = zip(plant["outputs"], plant["low"], plant["high"], strict=True)
    targets = {name: (low, high) for name, low, high in ends}
    if not guard.low and not guard.high:
        guard = replace(guard, **within(plant.get("bounds") or {}, wiring))
    knowledge = Knowledge(plant["library"], plant["known"], targets, planning=dict(cfg.planner))
    with instantiate(cfg.rig, _convert_="all")(system=system, dt=cfg.dt) as rig:
        session = Session(rig, wiring, guard, Path(cfg.folder))
        controller = load(cfg.controller) if cfg.controller else None
        if controller is None:
            session.excite(instantiate(cfg.excitation, _convert_="all")(n_u=system.signature.n_u, dt=cfg.dt))
        for _ in range(cfg.flights):
            if session.failed:
                break
            if controller is None or not cfg.controller:
                controller = session.learn(knowledge, cfg.seed)
            session.fly(controller, list(cfg.targets), cfg.seconds)
    print(f"Logs, model and controller: {cfg.folder}")
    if session.failed:
        sys.exit(1)


def within(bounds: dict[str, Any], wiring: Wiring) -> dict[str, dict[str, float]]:
    """Return the limits of the plant as ranges of its measured states; a single number is for both sides of zero."""
    seen = {name for name, known in zip(wiring.signature.state_names, wiring.seen, strict=True) if known}
    ends = {name: [-v, v] if isinstance(v, int | float) else v for name, v in bounds.items() if name in seen}
    return {"low": {name: end[0] for name, end in ends.items()}, "high": {name: end[1] for name, end in ends.items()}}


if __name__ == "__main__":
    main()
