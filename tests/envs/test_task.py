"""Tasks: rewards, observations and starts by their formulas."""

import math

import pytest
import torch
from torchrl.envs import check_env_specs

from dynasindy.envs import ControlEnv, RandomStep, Step, Tracking, TrackingReward, Wave
from dynasindy.systems import Pendulum, Signature, Tras, rk4

SIGNATURE = Tras().signature


WAVE = Wave([0.4, 0.3], [0.5, 0.25], offset=[0.1, -0.2])


def wanted(t):
    """The wave above in plain numbers."""
    return [0.1 + 0.4 * math.sin(2 * math.pi * 0.5 * t), -0.2 + 0.3 * math.sin(2 * math.pi * 0.25 * t)]


def test_errors_and_references_follow_the_time_of_each_row():
    task = Tracking(SIGNATURE, WAVE, observe_rate=True, error_scale=0.25)
    params = WAVE.sample(torch.Size((2,)), torch.Generator())
    x, t = torch.tensor([[0.5, -0.5, 1.0, -1.0, 400.0, -250.0]]).expand(2, 6), torch.tensor([[0.3], [1.1]])
    torch.testing.assert_close(task.reference(params, t), torch.tensor([wanted(0.3), wanted(1.1)]))
    seen = task.observation(x, params, t)
    for row, time in enumerate((0.3, 1.1)):
        a, p = wanted(time)
        errors = [(a - 0.5) / 0.25, (p + 0.5) / 0.25]
        slopes = [0.4 * math.pi * math.cos(math.pi * time), 0.15 * math.pi * math.cos(0.5 * math.pi * time)]
        assert seen[row].tolist() == pytest.approx([0.5, -0.5, 1, -1, 0.1, -0.1, *errors, *slopes], rel=1e-5)
        assert task.error(x, params, t)[row].tolist() == pytest.approx([a - 0.5, p + 0.5], rel=1e-5)
        assert seen[row, task.error_columns].tolist() == pytest.approx(errors, rel=1e-5)


def test_an_output_without_a_rate_is_not_damped_and_the_others_are():
    box = {"low": [-1.0, -2.0, -0.5], "high": [1.0, 2.0, 0.5]}
    reward, names = TrackingReward((0.0,), 10.0, 0.0), ["alpha_a", "omega_a", "alpha_p"]
    task = Tracking(SIGNATURE, Step([[0.0] * 3]), names, ["Omega_a", None, "Omega_p"], reward, **box)
    assert (task.rates, task.rated, task.rate_names) == ([2, 3], [0, 2], ["Omega_a", None, "Omega_p"])
    changes = torch.tensor([[0.0, 0.0, 0.4, 0.3, 0.0, 0.0]])
    params = task.sample(torch.Size((1,)), torch.Generator())
    paid = task.reward(torch.zeros(1, 6), changes, params, torch.zeros(1, 1), torch.tensor([False]))
    extents = task.boxes().tolist()
    assert paid.item() == pytest.approx(-10 * ((0.4 / extents[0]) ** 2 + (0.3 / extents[2]) ** 2))
    assert Tracking(SIGNATURE, Step([[0.0] * 2]), rates=[None, None]).rate_names == []


CART = Signature(("p", "theta", "v"), ("m", "rad", "m/s"), ("u",), (2.0, 0.3, 1.0))


def test_errors_and_rates_are_paid_and_seen_in_boxes_of_targets():
    def task(box):
        ends = {"low": [-1.0, 0.0], "high": [3.0, 0.0]} if box else {}
        reward = TrackingReward((4.0,), 0.5, 0.1, 0.01, width=0.05, error_shape="linear")
        return Tracking(CART, Step([[2.0, 0.0]]), ("p", "theta"), ("v", "v"), reward, **ends)

    x, x_next = torch.zeros(1, 3), torch.tensor([[1.6, 0.03, 0.2]])
    plain, boxed = task(False), task(True)
    params, t, free = boxed.sample(torch.Size((1,)), torch.Generator()), torch.zeros(1, 1), torch.zeros(1) > 0
    assert plain.boxes().tolist() == [1.0, 1.0]
    assert boxed.boxes().tolist() == [4.0, pytest.approx(0.3)]  # one target of its unit: the range of the state
    e = (0.4 / 4, 0.03 / 0.3)  # the error in shares of the box
    paid = -4 * sum(v * v / (0.05 + v) for v in e) - 0.5 * ((0.2 / 4) ** 2 + (0.2 / 0.3) ** 2)
    assert boxed.reward(x, x_next, params, t, free).item() == pytest.approx(paid, rel=1e-5)
    assert boxed.observation(x_next, params, t)[0, 3:].tolist() == pytest.approx([0.1 / 0.5, -0.1 / 0.5])


def test_bounds_are_both_ways_from_zero_or_the_two_ends_that_are_given():
    task = Tracking(SIGNATURE, WAVE, bounds={"alpha_p": 0.7, "Omega_a": [-2, 3.5]})
    inf = math.inf
    assert task.bounds.tolist() == [
        [-inf, pytest.approx(-0.7), -2, -inf, -inf, -inf],
        [inf, pytest.approx(0.7), 3.5, inf, inf, inf],
    ]


def test_episodes_begin_where_start_says():
    start = {"p": 0.5, "theta": [-0.1, 0.1]}
    task = Tracking(CART, Step([[1.0]]), ("p",), ("v",), TrackingReward((1.0,)), start=start)
    x = task.with_reference(Step([[2.0]])).initial_state(torch.Size((400,)), torch.Generator().manual_seed(0))
    assert (x[:, 0] == 0.5).all() and not x[:, 2].any()
    assert -0.1 <= x[:, 1].min() < -0.09 and 0.09 < x[:, 1].max() <= 0.1


def test_a_box_is_taken_as_it_is_given():
    task = Tracking(SIGNATURE, Step([[0.0, 0.0]]), low=[-1.0, -0.5], high=[1.0, 0.5])
    other = task.with_box([3.0, 0.5])
    assert other.boxes().tolist() == [3.0, 0.5] and task.boxes().tolist() == [2.0, 2.0]


def test_episodes_begin_at_one_of_the_states_that_are_given():
    starts = torch.arange(18.0).reshape(3, 6)
    task = Tracking(SIGNATURE, Step([[0.0, 0.0]]), start={"alpha_a": 9.0})
    chosen = task.with_starts(starts)
    drawn = chosen.initial_state(torch.Size((20, 10)), torch.Generator().manual_seed(0))
    assert drawn.shape == (20, 10, 6)
    rows, counts = drawn.reshape(-1, 6).unique(dim=0, return_counts=True)
    assert torch.equal(rows, starts) and int(counts.min()) > 40  # of 200, each third
    assert task.starts is None and float(task.initial_state(torch.Size(), torch.Generator())[0]) == 9.0
    assert chosen.with_reference(Step([[0.1, 0.1]])).starts is starts  # an evaluation begins there, too


def test_leaving_the_bounds_costs_where_it_is_asked_for_and_within_them_nothing_changes():
    signature = Signature(("a", "b"), ("m", "m"), ("u",), (1.0, 2.0))
    task = Tracking(signature, Step([[0.0]]), ["a"], (), TrackingReward((1.0,), 0.0, 0.0), bounds={"b": [-1.0, 3.0]})
    params, t, free = task.sample(torch.Size((3,)), torch.Generator()), torch.zeros(3, 1), torch.zeros(3) > 0
    x = torch.tensor([[0.5, 2.9], [0.5, 4.0], [0.5, -3.0]])
    paid, fenced = (one.reward(x, x, params, t, free) for one in (task, task.fenced(10.0)))
    # 0.5 and 1 range of 2 m beyond, at a cost of e^2 / (0.05 + e) each.
    cost = torch.tensor([0.0, 10 * 0.25 / 0.55, 10 * 1.0 / 1.05])
    torch.testing.assert_close(paid - fenced, cost, atol=1e-5, rtol=0)
    assert task.fence == 0.0
    assert Tracking(signature, Step([[0.0]]), ["a"], (), TrackingReward((1.0,))).fenced(9.0).fence == 0


def test_a_task_of_a_log_begins_where_the_log_was_and_sees_outputs_in_the_range_of_their_targets():
    far = Signature(("a", "b", "w"), ("rad", "m", "rad/s"), ("u",), (33.0, 1.9, 5.0))
    made = {
        "outputs": ["a", "b"],
        "rates": [],
        "reward": TrackingReward((1.0,)),
        "low": [-1.5, -1.0],
        "high": [0.5, 0.2],
    }
    task = Tracking(far, RandomStep([-1.5, -1.0], [0.5, 0.2]), **made)
    usual = torch.tensor([[16.0, -0.3, 1.5], [16.0, -0.3, 2.5]])
    logged = task.as_logged(usual)
    # 33 rad are more than three times 1.5 rad, 1.9 m less than 3 m; 16 rad is nearest to the target of 0.5 rad.
    assert logged.signature.x_scale == (4.5, 1.9, 5.0)
    begun = logged.initial_state(torch.Size((200,)), torch.Generator().manual_seed(0))
    assert begun[:, :2].unique(dim=0).tolist() == [[0.5, pytest.approx(-0.3)]]
    assert 1.5 <= begun[:, 2].min() < 1.6 and 2.4 < begun[:, 2].max() <= 2.5
    assert task.signature.x_scale == far.x_scale and task.start.abs().max() == 0
    given = Tracking(far, RandomStep([-1.5, -1.0], [0.5, 0.2]), **made, start={"a": 0.0})
    assert given.as_logged(torch.ones(2, 3)).start.abs().max() == 0
    small = Tracking(far, Step([[0.0]]), ["a"], [], TrackingReward((1.0,)), low=[-0.2], high=[0.4])
    assert small.as_logged(torch.ones(2, 3)).signature.x_scale[0] == pytest.approx(1.2)  # three times 0.4 rad
    upright = Tracking(far, Step([[0.0]]), ["a"], [], TrackingReward((1.0,)), low=[0.0], high=[0.0])
    assert upright.as_logged(torch.ones(2, 3)).signature.x_scale == far.x_scale
    free = Tracking(far, Step([[0.0]]), ["a"], [], TrackingReward((1.0,)))
    assert free.as_logged(torch.ones(2, 3)).start[0].tolist() == [1.0, 1.0, 1.0]


def test_a_state_that_follows_begins_beside_what_it_follows_unless_its_start_is_given():
    oven = Signature(("T", "T_lagging"), ("K", "K"), ("u",), (100.0, 100.0))
    ends = {"outputs": ["T"], "rates": [], "reward": TrackingReward((1.0,)), "low": [0.0], "high": [90.0]}

    def begun(start, typical=None):
        task = Tracking(oven, Step([[0.0]]), **ends, start=start).following({1: 0})
        task = task if typical is None else task.as_logged(torch.tensor(typical))
        x, (low, high) = task.initial_state(torch.Size((300,)), torch.Generator().manual_seed(0)), task.start_ends
        assert ((low <= x) & (x <= high)).all()
        return x

    x = begun({"T": [20.0, 60.0]})
    assert torch.equal(x[:, 0], x[:, 1]) and x[:, 0].min() < 21 and x[:, 0].max() > 59
    assert begun({"T": 50.0, "T_lagging": 7.0})[0].tolist() == [50.0, 7.0]
    behind = begun(None, [[80.0, -10.0], [80.0, 5.0]])
    assert (behind[:, 0] == 80).all() and 70 <= behind[:, 1].min() < 70.2 and 84.8 < behind[:, 1].max() <= 85
    assert begun({"T": 50.0}, [[80.0, -10.0], [80.0, 5.0]])[0].tolist() == [50.0, 50.0]


def test_inputs_that_a_log_has_not_tried_cost_as_states_beyond_their_bounds_do():
    task = Tracking(Pendulum().signature, Step([[0.0]]), ["theta"], ["Omega"], TrackingReward((1.0,)))
    assert not task.limited and task.fenced(10.0).effort(torch.ones(1, 1)) is None
    logged = task.as_logged(torch.zeros(2, 2), {"u": (-0.25, 0.75)})
    assert logged.limited and logged.limit(torch.tensor([[-1.0], [0.5]])).tolist() == [[-0.25], [0.5]]
    assert logged.effort(torch.ones(1, 1)) is None
    # Nothing within, and beyond by a quarter of the range, which is one, and by a half: e^2 / (0.05 + e) each.
    cost = logged.fenced(10.0).effort(torch.tensor([[0.5], [1.0], [-0.75]]))
    torch.testing.assert_close(cost, torch.tensor([0.0, 10 * 0.0625 / 0.3, 10 * 0.25 / 0.55]))
    deep = logged.fenced(10.0).effort(torch.tensor([0.5, 1.0, -0.75]).reshape(1, 3, 1))
    torch.testing.assert_close(deep, cost.unsqueeze(0))  # inputs are summed, dimensions of a batch are not
    x, t, free = torch.zeros(3, 2), torch.zeros(3, 1), torch.zeros(3, dtype=torch.bool)
    params = logged.sample(torch.Size((3,)), torch.Generator())
    paid = [
        one.earned(x, torch.tensor([[0.5], [1.0], [-0.75]]), x, params, t, free)
        for one in (logged, logged.fenced(10.0))
    ]
    torch.testing.assert_close(paid[0] - paid[1], cost)
    assert task.input_limits.tolist() == [[-1.0], [1.0]]
    assert task.with_input_limits([[1.0], [1.0]]).limited  # all that a log of 2 to 12 leaves
    assert task.with_input_limits([[-0.75], [1.0]]).limited and task.with_input_limits([[-1.0], [0.75]]).limited
    given = task.with_input_limits([[-0.5], [0.5]]).as_logged(torch.zeros(2, 2), {"u": (-0.25, 0.75)})
    assert given.input_limits.tolist() == [[-0.25], [0.5]]


class Folded(Tracking):
    """A task that shows the square of its first state as well."""

    def observation(self, x, params, t):
        return torch.cat([super().observation(x, params, t), x[..., :1].square()], -1)


class Chord(Tracking):
    """Sees errors as chords of a circle."""

    def error(self, x, params, t):
        return 2 * torch.sin(super().error(x, params, t) / 2)


@pytest.mark.parametrize("kind", [Tracking, Folded, Chord])
def test_observations_that_are_called_linear_change_by_the_same_from_everywhere(kind):
    plant = Tras()
    task = kind(plant.signature, RandomStep([-0.3, -0.3], [0.3, 0.3]))
    generator = torch.Generator().manual_seed(0)
    x, step = torch.randn(2, 50, 6, generator=generator, dtype=torch.float64)
    params = task.sample(torch.Size((50,)), generator).double()
    t = torch.rand(50, 1, generator=generator, dtype=torch.float64)
    change = task.observation(x + 2 * step, params, t) - task.observation(x, params, t)
    from_zero = task.observation(2 * step, 0 * params, 0 * t) - task.observation(0 * step, 0 * params, 0 * t)
    assert torch.allclose(change, from_zero, atol=1e-9) == task.linear == (kind is Tracking)


def pay(error, change=(0.0, 0.0), at_stop=False, **settings):
    reward = TrackingReward(**settings)
    return reward(torch.tensor(error), torch.tensor(change), torch.tensor(at_stop)).item()


@pytest.mark.parametrize(
    ("shape", "cost"),
    [
        ("quadratic", 0.3**2),
        ("linear", 0.3**2 / (0.2 + 0.3)),
        ("logarithmic", 0.2 * math.log(1 + (0.3 / 0.2) ** 2)),
    ],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_each_shape_is_its_formula_in_plain_numbers(shape, cost, sign):
    paid = pay((0.0, sign * 0.3), error_weights=(5.0, 2.0), error_shape=shape, width=0.2, bonus=0.0)
    assert paid == pytest.approx(-2 * cost)


@pytest.mark.parametrize("batch", [(), (4,)])
def test_a_task_without_references_is_an_environment_with_none(settle, batch):
    env = ControlEnv(Pendulum(), settle(Pendulum().signature), batch_size=batch)
    check_env_specs(env)
    rollout = env.rollout(3)
    assert rollout["reference"].shape == (*batch, 3, 0)
    assert rollout["task_params"].shape == (*batch, 3, 0)


def test_a_period_earns_its_reward_less_its_effort(settle):
    plant = Pendulum()
    env = ControlEnv(plant, settle(plant.signature, price=0.7), dtype=torch.float64)
    rollout = env.rollout(4)
    for row in rollout:
        x = row["state"]
        for _ in range(5):
            x = rk4(plant, x, row["action"].double(), 0.01)
        # Ranges of 1 rad and 3 rad/s.
        paid = -(x[0] ** 2) - (x[1] / 3.0) ** 2 - 0.7 * row["action"].double() ** 2
        torch.testing.assert_close(row["next", "reward"].double(), paid, rtol=1e-5, atol=1e-6)
