"""Noisy data: its spread, its order, its seed."""

import torch

from dynasindy.benchmarks.instruments.sensors import MeasuredReplay
from dynasindy.envs import ControlEnv
from dynasindy.systems import Xi
from dynasindy.tasks import Step, Tracking

STD = (1e-3, 2e-3, 1e-2, 2e-2, 20.0, 40.0)


def measured(seed=0):
    system = Xi()
    env = ControlEnv(system, Tracking(system.signature, Step([[0.2, 0.1]])), dtype=torch.float64, substeps=5)
    calm = env.rollout(60, lambda tensordict: tensordict.set("action", torch.full((2,), 0.1)))
    replay = MeasuredReplay(STD, seed, capacity=100, batch_size=8)
    replay.extend_real(calm)
    return calm, replay.real[:]


def test_samples_have_the_noise_and_follow_each_other():
    calm, stored = measured()
    spread = (stored["next", "samples"] - calm["next", "samples"]).std((0, 1))
    torch.testing.assert_close(spread, torch.tensor(STD, dtype=spread.dtype), rtol=0.2, atol=0)
    torch.testing.assert_close(stored["next", "state"], stored["next", "samples"][:, -1])
    torch.testing.assert_close(stored["state"][1:], stored["next", "samples"][:-1, -1])
    assert (stored["state"][0] != calm["state"][0]).all()


def test_what_was_done_and_rewarded_is_as_it_was():
    calm, stored = measured()
    for key in ("action", "observation", ("next", "reward")):
        torch.testing.assert_close(stored[key], calm[key], rtol=0, atol=0)


def test_noise_is_that_of_its_seed():
    one, again, other = (measured(seed)[1]["next", "samples"] for seed in (1, 1, 2))
    assert torch.equal(one, again) and not torch.equal(one, other)
