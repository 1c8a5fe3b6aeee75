"""Plants and tasks of two runs are the same where all their numbers are."""

from functools import partial

import pytest
import torch

from dynasindy.systems import Tras, Xi
from dynasindy.tasks import RandomStep, Tracking, TrackingReward
from dynasindy.together.alike import alike


def task(high=0.5, **given):
    return Tracking(Xi().signature, RandomStep([-0.5, -0.5], [high, 0.4]), **given)


def test_equal_plants_and_tasks_are_alike():
    assert alike(Xi()) == alike(Xi())
    assert alike(task()) == alike(task())
    assert hash(alike(task())) == hash(alike(task()))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (Xi(), Tras()),
        (Xi(), Xi(azimuth_stop=5.0)),
        (task(), task(high=0.6)),
        (task(), task(max_steps=401)),
        (task(), task(reward=TrackingReward(bonus=0.2))),
        (task(), task(start={"alpha_a": 0.1})),
        (torch.zeros(2), torch.zeros(2, dtype=torch.float64)),
        (torch.zeros(2), torch.zeros(2, 1)),
        ({"a": 1}, {"a": 2}),
        ((1, 2), [1, 2]),
        (partial(max, 1), partial(max, 2)),
        (lambda: 1, lambda: 1),
    ],
)
def test_what_differs_in_a_number_is_not(one, other):
    assert alike(one) != alike(other)


def test_generators_are_of_each_run_and_circles_end():
    assert alike(torch.Generator().manual_seed(1)) == alike(torch.Generator().manual_seed(2))
    one, other = {"x": 1}, {"x": 1}
    one["me"], other["me"] = one, other
    assert alike(one) == alike(other)


def test_machine_code_of_a_plant_makes_no_difference():
    used, unused = Xi(), Xi()
    used.compiled(torch.zeros(1, 6), torch.zeros(1, 2))
    assert alike(used) == alike(unused)
