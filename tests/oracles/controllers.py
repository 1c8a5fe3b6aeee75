"""Controllers of a pendulum and of a rotor plant, as small as they may be, with numbers that are no defaults."""

import torch

from dynasindy.agents.networks import actor
from dynasindy.control import Controller, Observer
from dynasindy.control.controller import ControlSetup
from dynasindy.envs import Sensors, Step, Tracking, TrackingReward
from dynasindy.sindy import SindyModel
from dynasindy.sindy.library import Library, of, variable
from dynasindy.sindy.named_libraries import rotor
from dynasindy.systems import Pendulum, Signature, Stops, Tras

HOSTILE = Signature(("int", "x y.z'-"), ("*/ int f() /*", "%/°*/"), ("_u",), (1.5, 3.0))
"""Names and units that mean something in C, Python, XML and LaTeX."""
PENDULUM = Signature(("theta", "Omega"), ("rad", "rad/s"), ("u",), (1.5, 3.0))


def angle_task(reference, **settings):
    """Return the task that the angle of a pendulum follows a reference."""
    return Tracking(Pendulum().signature, reference, ("theta",), ("Omega",), TrackingReward((4.0,)), **settings)


def policy_of(task, hidden=(8, 5), seed=1):
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return actor(task.n_o, task.signature.n_u, hidden).requires_grad_(False)


def pendulum_model(signature=PENDULUM, delay=0.0, step=None):
    angle, rate = signature.state_names
    push, omega = variable(signature.input_names[0]), variable(rate)
    words = [push, omega, of("tanh", angle, frequency=3.7), of("sin", angle), omega * of("abs", rate)]
    model = SindyModel(signature, Library(signature, words))
    table = [[0.0, 8.0], [1.0, -0.6], [0.0, -2.5], [0.0, -6.0], [0.0, -0.04]]
    model.set_coefficients(torch.tensor(table, dtype=torch.float64))
    model.delay = delay
    model.library = model.library.with_step(step)
    return model


def pendulum_controller(
    observer=True, integral=None, delay=0.07, stops=True, disturbance=True, signature=PENDULUM, ends=None, step=None
):
    """Return a controller of a pendulum whose angle is measured, with other ends of its input, `(2, 1)`, if given.

    With a step its model is the difference equation of that step [s].
    """
    angle, rate = signature.state_names
    task = Tracking(
        signature,
        Step([[0.0]]),
        (angle,),
        (rate,),
        TrackingReward((1.0,)),
        observe_rate=True,
        error_scale=0.5,
        low=[-0.4],
        high=[1.0],
    )
    if ends is not None:
        task = task.with_input_limits(ends)
    setup = ControlSetup(task, 0.04, 3, Stops((0,), (1,), (-0.6,), (0.25,)) if stops else None)
    if not observer:
        return Controller(policy_of(task), setup, None, integral)
    sensors = Sensors(
        {angle: {"resolution": 0.01, "noise": 0.002}}, rates={angle: rate}, delay=1, disturbance=disturbance
    )
    watching = Observer(pendulum_model(signature, delay, step), sensors, setup)
    watching.load_state_dict({"process_noise": [0.013, 0.021, 0.4][: 2 + disturbance], "nis": 1.1})
    return Controller(policy_of(task), setup, watching, integral)


def oven_controller(pushed=True):
    """Return a controller of an oven of which the air is measured; a wall that follows it has no sensor."""
    signature = Signature(("T", "T_lagging"), ("degC", "degC"), ("u",), (120.0, 120.0))
    words = ["1", "T", "u", "(T - T_lagging)"]
    model = SindyModel(signature, words, allowed={"T_lagging": words[-1:]})
    table = [[0.16, 0.0], [-0.002, 0.0], [0.12, 0.0], [-0.003, 1 / 360]]
    model.set_coefficients(torch.tensor(table, dtype=torch.float64))
    task = Tracking(signature, Step([[70.0]]), ("T",), (), TrackingReward((1.0,)), low=[50.0], high=[90.0])
    setup = ControlSetup(task, 5.0, 2)
    watching = Observer(model, Sensors({"T": {"resolution": 0.1, "noise": 0.05}}, disturbance=pushed), setup)
    watching.load_state_dict({"process_noise": [0.002, 0.002, 0.001][: 2 + pushed], "nis": 1.0})
    return Controller(policy_of(task), setup, watching, {"gain": 0.5})


def rotor_controller(integral=None, delay=0.03, damped=("Omega_a", "Omega_p")):
    """Return a controller of two rotors on a beam, of which angles and rotor speeds are measured."""
    signature = Tras().signature
    task = Tracking(signature, Step([[0.0, 0.0]]), rates=damped, reward=TrackingReward((1.0, 1.0)))
    setup = ControlSetup(task, 0.05, 2, Tras().stops)
    model = SindyModel(signature, rotor(signature))
    with torch.random.fork_rng():
        torch.manual_seed(5)
        scale = torch.tensor(signature.x_scale, dtype=torch.float64)
        x = (2 * torch.rand(3000, 6, dtype=torch.float64) - 1) * scale * 0.6
        u = 2 * torch.rand(3000, 2, dtype=torch.float64) - 1
    model.fit_derivatives(x, u, Tras()(x, u))
    model.delay = delay
    channels = {"alpha_a": {"resolution": 0.0015}, "alpha_p": {"resolution": 0.0015}}
    channels |= {name: {"noise": 30.0} for name in ("omega_a", "omega_p")}
    rates = {"alpha_a": "Omega_a", "alpha_p": "Omega_p"}
    observer = Observer(model, Sensors(channels, rates=rates, disturbance=True), setup)
    observer.load_state_dict({"process_noise": [0.01] * 6 + [0.05] * 2, "nis": 1.0})
    return Controller(policy_of(task, (24, 16), 2), setup, observer, integral)
