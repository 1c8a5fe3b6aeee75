"""Controllers and models as small as they may be: a cart on a rail, held by a linear law that is known by heart."""

import math

import torch

from dynasindy.agents.networks import actor
from dynasindy.control import Controller, Observer, save
from dynasindy.control.controller import ControlSetup
from dynasindy.envs import Sensors, Step, Tracking, TrackingReward
from dynasindy.evaluation.closed_loop import ClosedLoop
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature, Stops

CART = Signature(("p", "v"), ("m", "m/s"), ("force",), (2.0, 3.0))
DT = 0.1


class Law:
    """u = k_p (r - p) - k_v v + bias within a limit, of an observation of scaled states and errors."""

    def __init__(self, k_p, k_v, bias=0.0, limit=math.inf):
        self.k_p, self.k_v, self.bias, self.limit = k_p, k_v, bias, limit

    def __call__(self, tensordict):
        seen = tensordict["observation"]
        u = self.k_p * 0.7 * seen[..., 2:] - self.k_v * 3.0 * seen[..., 1:2] + self.bias
        return tensordict.set("action", u.clamp(-self.limit, self.limit))


def make_task(signature=CART, start=None):
    outputs, rates = signature.state_names[:1], signature.state_names[1:]
    return Tracking(signature, Step([[0.0]]), outputs, rates, TrackingReward((1.0,)), error_scale=0.7, start=start)


def make_cart(delay=0.0, friction=0.0, spring=0.0, step=None):
    """p' = v, v' = force - friction v - spring p; with a step [s] the difference equation of these changes."""
    model = SindyModel(CART, ["force", "v", "p"], known={"p": "v"})
    model.set_coefficients(torch.tensor([[0.0, 1.0], [1.0, -friction], [0.0, -spring]], dtype=torch.float64))
    model.delay, model.library = delay, model.library.with_step(step)
    return model


def watching(model, setup, **settings):
    sensors = Sensors({"p": {"noise": 0.01}}, rates={"p": "v"}, **settings)
    observer = Observer(model, sensors, setup)
    observer.load_state_dict({"process_noise": [0.01, 0.05] + [0.02] * sensors.disturbance, "nis": 1.0})
    return observer


def make_loop(law=None, model=None, observer=None, integral=None, stops=None, dt=DT, step=DT / 2, start=None):
    model = model or make_cart()
    setup = ControlSetup(make_task(start=start), dt, 2, stops)
    seeing = None if observer is None else watching(model, setup, **observer)
    controller = Controller(law or Law(2.0, 2.5), setup, seeing, integral)
    return ClosedLoop(controller, model, step)


def make_network_loop(delay=0.07, disturbance=True, late=1, integral=None):
    """A pendulum-like cart with a network, an observer that estimates a push, delays and stops."""
    model = make_cart(delay, 0.3, 0.8)
    setup = ControlSetup(make_task(), 0.04, 3, Stops((0,), (1,), (-0.6,), (0.6,)))
    with torch.random.fork_rng():
        torch.manual_seed(4)
        policy = actor(setup.task.n_o, 1, (8, 5)).requires_grad_(False)
    seeing = watching(model, setup, delay=late, disturbance=disturbance)
    return ClosedLoop(Controller(policy, setup, seeing, integral), model, 0.04 / 3)


def make_idle_controller(hidden=4):
    """A network that hardly acts."""
    task = make_task()
    policy = actor(task.n_o, 1, (hidden,)).requires_grad_(False)
    for weight in policy.parameters():
        weight *= 1e-3
    return Controller(policy, ControlSetup(task, DT))


def save_run(folder, spring=2.0):
    """Save what a run leaves of a cart at a spring, stable as it is by itself, and of a network that hardly acts."""
    save(make_idle_controller(), folder / "controller.json")
    make_cart(friction=0.5, spring=spring).save(folder / "model.json")
