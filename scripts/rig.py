"""Fly a rig: `python scripts/rig.py system=tras rig=udp rig.host=ADDRESS`; without `rig=`, a simulated one."""

import sys
from functools import partial
from pathlib import Path
from typing import Any

from cli import command, command_line, next_steps, run_steps, without


@command("rig")
def main(cfg: Any) -> None:
    """Excite, identify, plan while the rig rests, fly; or fly a controller that is there."""
    from hydra.core.hydra_config import HydraConfig
    from hydra.utils import instantiate
    from omegaconf import OmegaConf

    from dynasindy import load
    from dynasindy.dyna import Stopped
    from dynasindy.progress import Progress, say
    from dynasindy.rig import Wiring
    from dynasindy.rig.session import Knowledge, Session
    from dynasindy.safe_io import output_folder, write_text
    from dynasindy.viz.response import draw_session

    output_folder(Path(cfg.folder), "figures")  # refuses links in it before anything moves
    system, guard = (instantiate(cfg[name], _convert_="all") for name in ("system", "guard"))
    if not system.known:
        cfg.sensors = None  # what is known of it is what it sends, and for that it has sensors
    sensors = instantiate(cfg.sensors, _convert_="all")
    seen = tuple(name in sensors.channels for name in system.signature.state_names) if sensors else None
    wiring = Wiring(system.signature, seen or (True,) * system.signature.n_x, cfg.dt)
    plant = instantiate(cfg.plant, _convert_="all")
    if cfg.seconds is None or not cfg.seconds > 0 or cfg.flights < 1:
        raise ValueError(f"seconds={cfg.seconds}, flights={cfg.flights} fly nothing; give seconds > 0 and flights >= 1")
    targets = {name: tuple(ends) for name, *ends in zip(plant["outputs"], plant["low"], plant["high"], strict=True)}
    guard = guard.or_limits(plant.get("bounds") or {}, wiring)
    guard.require(wiring)
    # Of an unknown plant the logs tell which rates are missing.
    known = {} if system.known and plant.get("known") is None else plant.get("known")
    library, planner = plant.get("library", "auto"), dict(cfg.planner or {})
    knowledge = Knowledge(library, known, targets, cfg.longest_delay, planner, system.known)
    wanted = knowledge.within(cfg.targets)
    given = load(cfg.controller) if cfg.controller else None
    if given is None:
        knowledge.require_of(system.signature)
    print(guard.summary(wiring), flush=True)
    again = f"the same command with folder={cfg.folder} goes on and learns from all logs in it"
    with instantiate(cfg.rig, _convert_="all")(system=system, dt=cfg.dt) as rig:
        write_text(Path(cfg.folder) / "config.yaml", OmegaConf.to_yaml(cfg, resolve=True))  # targets, for check.py
        session = Session(rig, wiring, guard, Path(cfg.folder), tell=partial(print, flush=True))
        try:
            if given is None:
                session.excite(instantiate(cfg.excitation, _convert_="all")(n_u=system.signature.n_u, dt=cfg.dt))
            for _ in range(cfg.flights):
                if not session.failed:
                    with Progress():  # while the rig rests; in a flight nothing else may draw
                        controller = given or session.learn(knowledge, cfg.seed)
                    session.run_flight(controller, wanted, cfg.seconds)
        except KeyboardInterrupt as stop:
            told = f"stopped; the rig was asked for its safe input, its logs are in {cfg.folder}; {again}"
            raise Stopped(told, getattr(stop, "signal", 2)) from stop
    draw_session(session)
    print(f"Logs and what came of them: {cfg.folder}")
    if session.failed:
        print(f"Mend what ended the flight; {again}")
        sys.exit(1)
    if given is None:
        more = [*without(HydraConfig.get().overrides.task, "folder"), f"folder={cfg.folder}"]
        more_flights = command_line("rig", more, "learns from all logs in the folder and flies again")
        say(next_steps(*run_steps(cfg.folder, "check", "export"), more_flights))


if __name__ == "__main__":
    main()
