"""The tracking task as machine code, against its torch code and the formulas of its rewards."""

import copy
import math
import pickle

import numpy as np
import pytest
import torch

from dynasindy.envs import RandomStep, Tracking, TrackingReward, Wave
from dynasindy.envs.task import TrackingMachine
from dynasindy.systems import Signature
from dynasindy.systems.compiler import compiler

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
SIGNATURE = Signature(("a", "b", "c", "d"), ("rad", "rad/s", "m", "m/s"), ("u",), (1.5, 4.0, 0.3, 7.0))
REFERENCES = (
    RandomStep([-0.4, -0.2], [0.4, 0.3]),
    Wave((0.3, 0.2), (0.9, 0.7), random=True),
    Wave((0.3, 0.0), (0.9, 0.7), "square", (0.1, -0.2), random=True),
)


def task(rates=("b", "d"), **reward):
    return Tracking(
        SIGNATURE,
        REFERENCES[0],
        ("a", "c"),
        rates,
        TrackingReward(**{"tolerance": 0.4, **reward}),
        observe_rate=len(rates) != 1,
        low=(-0.5, -0.2),
        high=(0.5, 0.3),
    )


@pytest.mark.parametrize(("dtype", "apart"), [(torch.float32, 2e-6), (torch.float64, 1e-13)])
@pytest.mark.parametrize(
    "tracking",
    [
        task(),
        task(error_shape="linear", width=0.07, stop_penalty=3.0),
        task((None, "d"), error_shape="logarithmic", rate_weight=0.7),
        task((), error_weights=(2.0,), bonus=0.6),
    ],
)
def test_observations_references_and_rewards_are_those_of_the_torch_code(tracking, dtype, apart):
    random = torch.Generator().manual_seed(0)
    x, following = torch.randn(2, 3, 40, 4, generator=random, dtype=dtype)
    params = torch.stack([each.sample(torch.Size((40,)), random) for each in REFERENCES]).to(dtype)
    steps = torch.randint(0, 400, (3, 40, 1), generator=random)
    touched = torch.rand(3, 40, generator=random) < 0.5
    code = TrackingMachine.of(tracking, 0.05, dtype)
    found = code.judge(x, following, params, steps, touched)
    t = steps.to(dtype) * 0.05
    expected = {
        "observation": tracking.observation(following, params, t).float(),
        "reference": tracking.reference(params, t),
        "reward": tracking.reward(x, following, params, t, touched).float().unsqueeze(-1),
    }
    for key, values in expected.items():
        assert found[key].dtype == values.dtype and found[key].shape == values.shape
        limit = apart if key == "reference" else max(apart, 1e-6)
        np.testing.assert_allclose(found[key].numpy(), values.numpy(), rtol=limit, atol=10 * limit)
    again = code.judge(None, following, params, steps, None)
    assert set(again) == {"observation", "reference"} and torch.equal(again["observation"], found["observation"])


def test_a_reward_is_the_sum_of_its_terms():
    tracking = Tracking(
        SIGNATURE, RandomStep([0.5], [0.5]), ("a",), ("b",), TrackingReward((4.0,), 0.1, 0.3, 0.01, 2.0)
    )
    code = TrackingMachine.of(tracking, 0.1, torch.float64)
    x = torch.tensor([[0.0, 1.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]], dtype=torch.float64)
    following = torch.tensor([[0.3, 1.5, 0.0, 0.0], [0.495, 1.0, 0.0, 0.0]], dtype=torch.float64)
    params = tracking.sample(torch.Size((2,)), torch.Generator()).double()
    steps, touched = torch.ones(2, 1, dtype=torch.int64), torch.tensor([False, True])
    paid = code.judge(x, following, params, steps, touched)["reward"].squeeze(-1).tolist()
    assert paid == pytest.approx([-4 * 0.04 - 0.1 * 0.25, -4 * 0.005**2 + 0.3 - 2], rel=1e-6)


def test_only_the_tracking_task_itself_has_machine_code():
    class Other(Tracking):
        def error(self, x, params, t):
            return super().error(x, params, t).sin()

    class Power(TrackingReward):
        pass

    step = RandomStep([0.5], [0.5])
    assert TrackingMachine.of(Other(SIGNATURE, step, ("a",), (), TrackingReward((1.0,))), 0.1, torch.float32) is None
    assert TrackingMachine.of(Tracking(SIGNATURE, step, ("a",), (), Power((1.0,))), 0.1, torch.float32) is None
    bounded = Tracking(SIGNATURE, step, ("a",), (), TrackingReward((1.0,)), bounds={"a": math.pi})
    assert TrackingMachine.of(bounded, 0.1, torch.float32) is not None
    assert TrackingMachine.of(bounded.fenced(10.0), 0.1, torch.float32) is None
    assert TrackingMachine.of(bounded, 0.1, torch.bfloat16) is None


def test_copies_are_made_anew():
    code, x = TrackingMachine.of(task(), 0.1, torch.float32), torch.rand(1, 4)
    params, steps = (
        task().sample(torch.Size((1,)), torch.Generator().manual_seed(0)),
        torch.ones(1, 1, dtype=torch.int64),
    )
    found = code.judge(None, x, params, steps, None)["observation"]
    others = copy.deepcopy(code), pickle.loads(pickle.dumps(code))
    del code
    for other in others:
        assert torch.equal(other.judge(None, x, params, steps, None)["observation"], found)
