"""What a policy begins with: it keeps to the law that it imitates, and takes one only where that earns more."""

import math
from types import SimpleNamespace

import torch
from torch import nn

from dynasindy.agents.networks import MLP
from dynasindy.envs import ControlEnv
from dynasindy.planning.imitation import ROWS, _arrives, _bears_delay, _imitate, _regulators, hold
from dynasindy.planning.regulator import Regulator
from dynasindy.planning.rollout import Rows


def test_a_policy_that_imitates_the_law_holds_the_plant_and_keeps_to_it(inverted):
    env, rests = inverted()
    torch.manual_seed(0)
    network, law = MLP(3, 1, (32, 32), squash=True), Regulator.of(env, rests)
    _imitate(network, law, env, torch.Generator().manual_seed(0))
    x = torch.tensor([[0.3, 0.0], [-0.3, 0.1]])
    params = torch.zeros(2, 1, 5)
    params[:, 0, 0] = torch.tensor([-0.2, 0.4])
    with torch.no_grad():
        for k in range(100):
            x = env.advance(x, network(env.task.observation(x, params, torch.full((2, 1), 0.05 * k))))[0][..., -1, :]
    torch.testing.assert_close(x[:, 0], params[:, 0, 0], atol=0.02, rtol=0)


def test_every_other_lesson_begins_around_a_rest_and_the_rest_where_episodes_do(inverted):
    env, rests = inverted(start={"theta": [0.3, 0.3]})
    law, begun = Regulator.of(env, rests), []
    near = law.near

    class Watched(MLP):
        def forward(self, observation):
            begun.append(observation)
            return super().forward(observation)

    def watched(targets, rng):
        begun.clear()
        return 0 * near(targets, rng) - 0.2

    law.near = watched
    network = Watched(3, 1, (8,), squash=True)
    _imitate(network, law, env, torch.Generator().manual_seed(0), (2, 0))
    first = next(seen for seen in begun if len(seen) == ROWS)
    torch.testing.assert_close(first[:, 0], torch.tensor([-0.2, 0.3]).repeat(ROWS // 2))


def test_a_policy_begins_as_the_law_only_if_that_earns_more(inverted):
    env, rests = inverted()

    def held(score):
        torch.manual_seed(0)
        network = MLP(3, 1, (8,), squash=True)
        before = nn.utils.parameters_to_vector(network.parameters()).clone()
        rows = Rows.draw(env, 4, torch.Generator())
        rng = torch.Generator().manual_seed(0)
        planner = SimpleNamespace(network=network, env=env, held_out=rows, test=score(network), rng=rng)
        earned = hold(planner, rests, keep=False)
        return earned.score, bool((nn.utils.parameters_to_vector(network.parameters()) == before).all())

    assert held(lambda network: lambda policy: 1.0 if policy is network else 0.0) == (1.0, True)  # no law is better
    scores = iter(
        [0.0, 2.0, 3.0, 5.0, 7.0, 6.0, 5.0, 6.5]
    )  # the network, six laws, the network that imitates the best of them
    assert held(lambda network: lambda policy: next(scores)) == (6.5, False)
    scores = iter([0.0, 2.0, 3.0, 5.0, 7.0, 6.0, 5.0, -1.0])  # imitation fails
    assert held(lambda network: lambda policy: next(scores)) == (0.0, True)


def test_a_law_arrives_where_the_plant_rests_at_every_target_in_the_end(inverted):
    """A torque of 2 cannot lift a weight of 4 from hanging in one go; from a lean of 0.1 rad it holds."""
    for start, arrived in (({"theta": [-0.1, 0.1]}, True), ({"theta": [math.pi, math.pi]}, False)):
        env, rests = inverted(pull=2.0, start=start, box=0.01, max_steps=120)
        law = Regulator.of(env, rests)
        assert _arrives(law, env, rests, torch.Generator().manual_seed(0)) is arrived
        assert not _arrives(lambda o: torch.ones(*o.shape[:-1], 1), env, rests, torch.Generator().manual_seed(0))


def test_inputs_a_period_late_hold_a_pole_only_where_it_falls_by_less_than_twice_in_a_period(inverted):
    """Of x[k+1] = f x[k] + g u[k-1] no feedback of x[k] is stable beyond f = 2; here f = exp(2 dt)."""
    for dt, borne in ((0.05, True), (0.4, False)):
        env, rests = inverted(box=0.01, start={"theta": [-0.05, 0.05]})
        env = ControlEnv(env.system, env.task, dt, 8)
        rows = Rows.draw(env, 8, torch.Generator().manual_seed(0))
        rows.late = torch.ones(8, 1)
        assert _bears_delay(_regulators(env, rests), env, rows) is borne
