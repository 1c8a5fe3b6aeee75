"""Runs on a GPU, and torch code in its place on the CPU where there is none."""

from dataclasses import replace
from functools import partial

import pytest
import torch
from recipes import Heard, make_recipe

from dynasindy.agents import TD3, DynaReplay
from dynasindy.dyna.experiment import LoopSettings
from dynasindy.dyna.loop import train
from dynasindy.envs import ControlEnv, Multisine
from dynasindy.limits import device
from dynasindy.planning import GradientPlanning, ImaginedReplay
from dynasindy.sindy import Regression, SindyModel
from dynasindy.systems import Xi

needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
PLANNERS = {
    "none": partial(ImaginedReplay, rollouts=0, every=10**6),
    "dyna": partial(ImaginedReplay, rollouts=16, horizon=40),
    "gradient": partial(GradientPlanning, updates=4, more_updates=2, rollouts=8, window=5, check_every=2, searches=0),
}
KNOWN = {"alpha_a": "Omega_a", "alpha_p": "Omega_p"}


class NoCode(SindyModel):
    """A model that is moved by torch code."""

    def compiled(self, x, u):
        return None


def recipe(planning, where="cpu", model=SindyModel, **agent):
    return make_recipe(
        Xi(),
        30,
        env=partial(ControlEnv, dt=0.1, substeps=2, dtype=torch.float64),
        excitation=partial(Multisine, duration=3.0),
        world_model=partial(model, known=KNOWN, regression=Regression("bic")),
        agent=partial(TD3, hidden=(32, 24), policy_average=0.1, **agent),
        replay=partial(DynaReplay, 500, 64, 0.5),
        planning=PLANNERS[planning],
        train=LoopSettings(2, 0.5, held_out=0),
        seed=3,
        device=where,
    )


def trained(*given, **settings):
    """Return the parts of a run that has ended, and its returns."""
    one = recipe(*given, **settings)
    parts, heard = one.build(), Heard()
    train(parts, one.train, heard)
    return parts, torch.stack([episode.rollout["next", "reward"].sum().cpu() for episode in heard.episodes])


def tensors(parts):
    """Return the networks, and what learning keeps beside them."""
    agent = parts.agent
    found = {name: value for name, value in agent.loss.state_dict().items() if "_params" in name}
    for name in ("actor_optimizer", "critic_optimizer"):
        for number, state in getattr(agent, name).state_dict()["state"].items():
            found |= {f"{name}.{number}.{key}": state[key] for key in ("exp_avg", "exp_avg_sq")}
    return found | {f"deployed.{name}": value for name, value in agent.deployed.state_dict().items()}


def assert_close(one, other):
    """Compare runs that differ by rounding alone: their returns, networks and imagined transitions."""
    (parts, returns), (others, wanted) = one, other
    torch.testing.assert_close(returns, wanted, rtol=1e-3, atol=1e-3)
    found, expected = tensors(parts), tensors(others)
    assert found.keys() == expected.keys() and len(found) >= 30
    for name, value in found.items():
        torch.testing.assert_close(value.cpu(), expected[name], rtol=2e-2, atol=2e-4, msg=lambda m, n=name: f"{n}: {m}")
    assert len(parts.replay.model) == len(others.replay.model)
    if len(parts.replay.model):
        for key in ("observation", "action", ("next", "observation"), ("next", "reward")):
            a, b = (each.replay.model[:][key].cpu() for each in (parts, others))
            torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-3)


def test_torch_code_learns_and_imagines_what_machine_code_does():
    plain = trained("dyna", model=NoCode, machine_code=False)
    assert_close(plain, trained("dyna"))
    assert len(plain[0].replay.model) > 100


@pytest.mark.parametrize("name", ["tpu", "cuda:99", "meta"])
def test_a_device_that_is_not_there_is_refused(name):
    with pytest.raises(ValueError, match=f"device={name} "):
        device(name)
    with pytest.raises(ValueError, match=f"device={name} "):
        replace(recipe("none"), device=name).build()


@needs_gpu
@pytest.mark.parametrize("planning", PLANNERS)
def test_a_run_on_a_gpu_is_the_run_on_the_cpu_up_to_rounding(planning):
    there = trained(planning, "cuda")
    parts = there[0]
    assert {value.device.type for value in tensors(parts).values()} == {"cuda"}
    assert parts.replay.real[:]["observation"].is_cuda and parts.replay.sample()["next", "reward"].is_cuda
    if planning == "dyna":
        assert parts.replay.model[:]["observation"].is_cuda
    assert parts.replay.real_in_order()["state"].is_cpu
    assert_close(there, trained(planning))
