"""Gymnasium both ways: its own checker, and environments stepped by hand."""

import copy
import math
import pickle
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces

import dynasindy  # noqa: F401 (registers the environments)
from dynasindy.envs import ControlEnv, Foreign, GymnasiumEnv, Step, Tracking, TrackingReward, Wave
from dynasindy.envs.drawing import draw
from dynasindy.envs.gym import _GymControl, _Observed, pendulum, twin_rotor
from dynasindy.evaluation.scenarios import Scenario, evaluate
from dynasindy.systems import Tras

IDS = ["dynasindy/TwinRotor-v0", "dynasindy/Pendulum-v0"]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_adapter_plays_what_the_control_env_plays_and_pays_for_stops(dtype) -> None:
    system = Tras(azimuth_stop=0.05)
    reward = TrackingReward(stop_penalty=3.0)
    task = Tracking(system.signature, Wave((0.3, 0.2), (0.9, 0.7)), reward=reward, observe_rate=True, max_steps=40)
    plain = ControlEnv(system, task, dtype=dtype)
    actions = torch.full((40, 2), 0.6)
    expected = plain.rollout(40, actions=actions)["next"]
    assert 0 < int(expected["at_stop"].sum()) < 40
    env = _GymControl(ControlEnv(system, task, dtype=dtype))
    np.testing.assert_array_equal(env.reset(seed=0)[0], plain.rollout(1, actions=actions[:1])["observation"][0])
    for k in range(40):
        observation, reward, terminated, truncated, info = env.step(actions[k].numpy())
        assert not terminated and truncated == (k == 39)
        np.testing.assert_array_equal(observation, expected["observation"][k].numpy())
        np.testing.assert_array_equal(info["state"], expected["state"][k].numpy())
        np.testing.assert_array_equal(info["reference"], expected["reference"][k].numpy())
        assert reward == pytest.approx(expected["reward"][k].item())


def test_seeds_repeat_sequences_of_episodes_and_leave_the_global_generator_alone() -> None:
    env = twin_rotor()
    before = torch.random.get_rng_state()
    first = [env.reset(seed=5)[1]["reference"], env.reset()[1]["reference"]]
    second = [env.reset(seed=5)[1]["reference"], env.reset()[1]["reference"]]
    assert torch.equal(before, torch.random.get_rng_state())
    np.testing.assert_array_equal(first, second)
    assert (first[0] != first[1]).any()


def test_actions_out_of_range_are_clipped() -> None:
    env = twin_rotor(plant="xi")
    results = []
    for size in (1.0, 7.0):
        env.reset(seed=1)
        results.append(env.step(np.array([size, -size], dtype=np.float32))[0])
    np.testing.assert_array_equal(*results)


def test_spaces_and_the_papers_references_are_those_documented() -> None:
    env = twin_rotor(render_mode="rgb_array")
    assert env.observation_space.shape == (8,) and env.action_space.shape == (2,)
    assert (env.action_space.low == -1).all() and (env.action_space.high == 1).all()
    assert (env.observation_space.low < -1e38).all() and (env.observation_space.high > 1e38).all()
    assert env.metadata == {"render_modes": ["rgb_array"], "render_fps": 20}  # a control period is 0.05 s
    drawn = np.array([env.reset(seed=k)[1]["reference"] for k in range(60)])
    np.testing.assert_allclose(np.abs(drawn).max(0), [0.4, 0.25], atol=0.03)
    np.testing.assert_allclose(drawn.min(0), [-0.4, -0.25], atol=0.05)
    narrow = twin_rotor(low=(0.1, 0.2), high=(0.1, 0.2)).reset()[1]["reference"]
    np.testing.assert_allclose(narrow, [0.1, 0.2], rtol=1e-6)


def test_the_pendulum_tracks_its_angle_for_the_papers_weights() -> None:
    env = pendulum(low=0.5, high=0.5)
    observation, _ = env.reset(seed=0)
    np.testing.assert_allclose(observation, [0, 0, 1.0])  # an error of 0.5 rad counts as 1
    _, reward, _, _, after = env.step(np.array([0.3], dtype=np.float32))
    theta, rate = after["state"]
    assert reward == pytest.approx(-4 * (0.5 - theta) ** 2 - 0.1 * rate**2, rel=1e-5)
    drawn = np.array([pendulum().reset(seed=k)[1]["reference"].item() for k in range(60)])
    assert -1 < drawn.min() < -0.9 and 0.9 < drawn.max() < 1


def test_pictures_show_the_present_and_are_made_only_when_asked_for() -> None:
    env = twin_rotor(render_mode="rgb_array")
    assert env.render() is None  # nothing to show before the first reset
    env.reset(seed=0)
    for _ in range(3):
        _, _, _, _, info = env.step(np.array([1.0, 0.5], dtype=np.float32))
    expected = draw(Tras().signature, info["state"].tolist(), info["reference"].tolist(), [0, 1], "t = 0.15 s")
    np.testing.assert_array_equal(env.render(), expected)
    silent = twin_rotor()
    silent.reset(seed=0)
    assert silent.render() is None


def test_an_environment_that_steps_in_its_own_way_is_played_as_it_is() -> None:
    """Pendulum-v1 itself, put to where the episode begins, moves alike; cosine and sine tell the error."""
    system = Foreign("Pendulum-v1", {"c": 1.0, "s": 1.0, "w": 8.0}, ["torque"])
    task = Tracking(system.signature, Step([[1.0, 0.0]]), ("c", "s"), (), TrackingReward((4.0,)), max_steps=3)
    env, bare = _GymControl(GymnasiumEnv(system, task)), gymnasium.make("Pendulum-v1")
    bare.reset()
    c, s, w = env.reset(seed=5)[1]["state"]
    bare.unwrapped.state = np.array([np.arctan2(s, c), w])
    for k in range(1, 4):
        _, reward, terminated, truncated, info = env.step(np.array([0.5], dtype=np.float32))
        seen, *_ = bare.step(np.array([1.0], dtype=np.float32))  # torques of -2 to 2
        np.testing.assert_allclose(info["state"], seen, rtol=1e-5)
        paid = -4 * ((1 - seen[0]) ** 2 + seen[1] ** 2)
        assert reward == pytest.approx(paid, rel=1e-5) and (terminated, truncated) == (False, k == 3)


@pytest.mark.parametrize(
    "order",
    [
        "import dynasindy, gymnasium",
        "import gymnasium, dynasindy",
        "import dynasindy, importlib.util; importlib.util.find_spec('gymnasium'); import gymnasium",
    ],
)
def test_gymnasium_has_the_environments_whichever_is_imported_first(order: str) -> None:
    code = f"{order}; print(*(name for name in gymnasium.registry if name.startswith('dynasindy/')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == set(IDS)


def test_the_package_alone_imports_neither_gymnasium_nor_numpy() -> None:
    code = "import sys, dynasindy; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"gymnasium", "numpy"} & set(done.stdout.split())


@pytest.mark.parametrize("name", IDS)
def test_copies_within_an_episode_go_on_by_themselves(name):
    env = gymnasium.make(name).unwrapped
    action = np.full(env.action_space.shape, 0.3, np.float32)
    env.reset(seed=1)
    env.step(action)
    copies = copy.deepcopy(env), pickle.loads(pickle.dumps(env))
    expected = [env.step(action)[0] for _ in range(3)]
    for each in copies:
        assert all(np.array_equal(each.step(action)[0], seen) for seen in expected)


@pytest.mark.parametrize("name", IDS)
def test_an_action_of_another_shape_is_refused(name):
    env = gymnasium.make(name).unwrapped
    env.reset(seed=0)
    with pytest.raises(ValueError, match="shape"):
        env.step(np.zeros(3))


PENDULUM = {"states": {"c": 1.0, "s": 1.0, "w": 8.0}, "inputs": ["torque"]}
BY_HAND = "by_hand/Steps-v0"


class Steps(gymnasium.Env):
    """x1' = x1 + u1, clipped at 1; x2' = x2 + u2, without ends; inputs from -1 to 3 and from 0 to 1."""

    observation_space = spaces.Box(np.array([-2.0, -np.inf]), np.array([1.0, np.inf]), dtype=np.float64)
    action_space = spaces.Box(np.array([-1.0, 0.0]), np.array([3.0, 1.0]), dtype=np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = np.zeros(2)
        return self.x, {}

    def step(self, action):
        self.x = self.x + action
        self.x[0] = np.clip(self.x[0], -2.0, 1.0)
        return self.x, 1.0, False, False, {}


gymnasium.register(BY_HAND, Steps)


class Short(Steps):
    """The same, which cuts an episode short beyond 2 of x2, though nothing is lost there."""

    def step(self, action):
        x, reward, *_ = super().step(action)
        return x, reward, False, bool(self.x[1] > 2), {}


gymnasium.register("tests/Short-v0", Short)


def test_an_environment_that_cuts_an_episode_short_is_heeded():
    env = environment("tests/Short-v0", {"x1": 0.0}, dt=0.1)
    stepped = env.rollout(200, lambda td: td.set("action", torch.ones(2)), auto_reset=True)
    assert stepped.numel() == 3  # x2 is 1, 2, 3
    last = stepped["next"][-1]
    assert bool(last["truncated"]) and bool(last["done"]) and not bool(last["terminated"])
    played = _GymControl(env)
    played.reset(seed=0)
    assert [played.step(np.ones(2))[2:4] for _ in range(3)] == [(False, False), (False, False), (False, True)]


class Fuse(Steps):
    """The same, which ends an episode at 1 of x1, at an end of it."""

    def step(self, action):
        x, reward, *_ = super().step(action)
        return x, reward, bool(x[0] >= 1), False, {}


gymnasium.register("tests/Fuse-v0", Fuse)


@pytest.mark.parametrize(("u", "expected"), [(-0.5, []), (-0.2, [{"x1": [-1.6, 0.62]}])])  # 0 and 0.6 a step
def test_bounds_are_proposed_where_an_environment_ended_runs_at_the_end_of_a_state(u, expected):
    env = environment("tests/Fuse-v0", {"x1": 0.0}, dt=0.1)
    action = torch.tensor([u, -1.0])
    runs = evaluate(env, lambda td: td.set("action", action.expand(*td.batch_size, 2)), Scenario("step"))
    assert [each.values["bounds"] for each in runs.ended_runs(env.foreign.ends)] == expected


def test_an_action_is_held_for_the_steps_of_a_control_period_and_paid_for_all_of_them():
    env = environment("tests/Short-v0", {"x1": 0.0}, dt=0.1, repeat=2)
    stepped = env.rollout(200, lambda td: td.set("action", torch.tensor([-0.5, -0.4])), auto_reset=True)["next"]
    # -0.4 of the range from 0 to 1 is 0.3 a step: x2 is 0.6, 1.2, 1.8, and the first step of the fourth goes beyond 2.
    torch.testing.assert_close(stepped["state"][:, 1], torch.tensor([0.6, 1.2, 1.8, 2.1], dtype=torch.float64))
    assert stepped["own_reward"].flatten().tolist() == [2.0, 2.0, 2.0, 1.0]
    ended = [False, False, False, True]  # half a period obeys no equation of a whole one
    assert stepped["at_stop"].flatten().tolist() == ended
    with pytest.raises(ValueError, match="repeat"):
        Foreign("tests/Short-v0", repeat=0)
    pendulum = Foreign("Pendulum-v1", repeat=3)  # episodes of 200 steps of 0.05 s
    assert pendulum.registered_steps == 66 and pendulum.period == pytest.approx(0.15)
    copy = pendulum.make(2)
    copy.reset(seed=0)
    assert [copy.step(np.zeros(1, np.float32))[3] for _ in range(2)] == [False, True]


class Grouped(Steps):
    """The same, whose observation is a dictionary, as those of dm_control are."""

    observation_space = spaces.Dict({"place": spaces.Box(-2.0, 1.0, (1,)), "rest": spaces.Box(-np.inf, np.inf, (1,))})

    def reset(self, *, seed=None, options=None):
        return self.grouped(super().reset(seed=seed)[0]), {}

    def step(self, action):
        x, *others = super().step(action)
        return self.grouped(x), *others

    def grouped(self, x):
        return {"rest": x[1:].astype(np.float32), "place": x[:1].astype(np.float32)}


gymnasium.register("tests/Grouped-v0", Grouped)


def test_an_observation_that_is_a_dictionary_is_read_in_the_order_of_its_keys():
    env = environment("tests/Grouped-v0", {"x1": 0.0}, dt=0.1)
    x = env.rollout(3, lambda td: td.set("action", torch.tensor([-0.25, 0.0])))["next", "state"]
    assert env.foreign.ends[0].tolist() == [-2.0, -math.inf]
    # -0.25 of the inputs' ranges is 0.5 and 0.5.
    assert x.tolist() == [[0.5, 0.5], [1.0, 1.0], [1.0, 1.5]]


def environment(name, target, max_steps=200, seed=0, **settings):
    settings, dt = {k: v for k, v in settings.items() if k != "dt"}, settings.get("dt")
    system = Foreign(name, **settings)
    columns, values = list(target), [list(target.values())]
    task = Tracking(system.signature, Step(values), columns, (), TrackingReward((4.0,)), max_steps)
    return GymnasiumEnv(system, task, name, dt, seed=seed)


def foreign_pendulum(**settings):
    return environment("Pendulum-v1", {"c": 1.0, "s": 0.0}, **PENDULUM, **settings)


def car(max_steps=300):
    states = {"p": 1.2, "v": 0.07}
    return environment("MountainCarContinuous-v0", {"p": 0.47}, max_steps, states=states, dt=1.0)


def pumping(tensordict):
    """Push with the speed, which takes energy in: a car in a valley comes out."""
    v = tensordict["state"][..., -1:]
    return tensordict.set("action", torch.where(v >= 0, 1.0, -1.0).float())


def test_a_rollout_is_the_environment_stepped_by_hand_with_the_torque_doubled():
    env = foreign_pendulum()
    actions = torch.rand(60, 1, generator=torch.Generator().manual_seed(1)) * 2.4 - 1.2  # some beyond the ends
    seeds, copy = [], gymnasium.make("Pendulum-v1")
    for seed in (3, 4):
        env.rng.manual_seed(seed)
        seeds.append(int(torch.randint(2**31, (1,), generator=torch.Generator().manual_seed(seed))))
        now, (x, _) = env.start_from(torch.zeros(3)), copy.reset(seed=seeds[-1])
        np.testing.assert_array_equal(now["state"].numpy(), x)
        assert float(now["own_reward"]) == 0.0
        for u in actions:
            after = env.step(now.set("action", u))
            x, paid, terminated, _, _ = copy.step(2.0 * u.clamp(-1.0, 1.0).numpy())
            np.testing.assert_allclose(after["next", "state"].numpy(), x, rtol=0, atol=1e-6)
            assert float(after["next", "own_reward"]) == pytest.approx(paid, rel=1e-6)
            assert not terminated and not after["next", "done"]
            now = env.step_mdp(after)
    assert seeds[0] != seeds[1]


def test_rows_are_copies_of_their_own_and_inputs_are_scaled_between_their_ends():
    """Inputs 0, -1, 1 of -1 to 3 are 1, -1, 3; of 0 to 1 they are 0.5, 0, 1."""
    env = environment(BY_HAND, {"x2": 0.0}, dt=0.1)
    u = torch.tensor([[0.0, 0.0], [-1.0, -1.0], [1.0, 1.0], [-1.0, 0.0]])
    now = env.start_from(torch.zeros(4, 2))
    for k in (1, 2):
        after = env.step(now.set("action", u))["next"]
        expected = k * torch.tensor([[1.0, 0.5], [-1.0, 0.0], [3.0, 1.0], [-1.0, 0.5]]).double()
        expected[:, 0] = expected[:, 0].clamp(-2.0, 1.0)
        assert torch.equal(after["state"], expected)
        assert after["at_stop"].flatten().tolist() == [True, k == 2, True, k == 2]
        assert after["own_reward"].flatten().tolist() == [1.0] * 4
        assert torch.equal(after["samples"], expected.unsqueeze(1))
        now = env.step_mdp(now.set("next", after))


def test_ends_are_stops_of_the_states_that_are_named():
    """At full torque the pendulum, whose c and s have ends of 1, reaches its ends of 8 rad/s."""

    def flight(**settings):
        env = foreign_pendulum(**settings)
        return env.rollout(200, pumping)["next"]

    w = flight()["state"][:, 2].abs()
    assert 0 < int((w == 8.0).sum()) < 200
    assert torch.equal(flight(stops=["w"])["at_stop"][:, 0], w == 8.0)
    assert not flight(stops=[])["at_stop"].any()


@pytest.mark.parametrize(
    ("settings", "names", "ranges"),
    [
        (PENDULUM, ("c", "s", "w"), (1.0, 1.0, 8.0)),
        ({"states": {"c": 2.0, "s": 3.0, "w": 4.0}}, ("c", "s", "w"), (2.0, 3.0, 4.0)),
        ({"states": ["a", "b", "d"]}, ("a", "b", "d"), (1.0, 1.0, 8.0)),
        ({}, ("x1", "x2", "x3"), (1.0, 1.0, 8.0)),
    ],
)
def test_names_and_ranges_are_those_given_or_those_of_the_spaces(settings, names, ranges):
    system = Foreign("Pendulum-v1", **settings)
    assert system.signature.state_names == names and system.signature.x_scale == ranges
    assert system.signature.input_names == (("torque",) if "inputs" in settings else ("u1",))
    assert system.signature.state_units == ("-",) * 3 and not system.known
    with pytest.raises(TypeError, match="Pendulum-v1"):
        system(torch.zeros(3), torch.zeros(1))


def test_the_period_is_that_of_the_environment_unless_given():
    assert foreign_pendulum().dt == gymnasium.make("Pendulum-v1").unwrapped.dt == 0.05
    assert foreign_pendulum(dt=0.1).dt == 0.1
    with pytest.raises(ValueError, match="MountainCarContinuous-v0"):
        environment("MountainCarContinuous-v0", {"x1": 0.47})


def test_a_row_that_is_over_ends_a_training_episode():
    """The flag is at 0.45; the environment pays 100 there, less 0.1 for the last input."""
    rows = car().rollout(300, pumping)
    p, end = rows["next", "state"][:, 0], rows["next"][-1]
    assert 50 < len(rows) < 200 and p[-1] >= 0.45 and bool((p[:-1] < 0.45).all())
    assert bool(end["truncated"]) and bool(end["done"]) and not bool(end["terminated"])  # to end early is no gain
    assert rows["next", "own_reward"].flatten().tolist() == pytest.approx([-0.1] * (len(rows) - 1) + [99.9], rel=1e-5)


def test_a_row_that_is_over_stays_there_in_an_evaluation():
    env = car()
    calm = env.with_task(env.task)
    start = calm.start_from(torch.zeros(3, 2))
    rows = calm.rollout(300, pumping, auto_reset=False, tensordict=start, break_when_any_done=False)
    assert rows.shape == (3, 300) and not rows["next", "terminated"].any()
    for row in rows:
        p, paid = row["next", "state"], row["next", "own_reward"].flatten()
        first = int((p[:, 0] >= 0.45).nonzero()[0])
        assert torch.equal(p[first:], p[first].expand(300 - first, -1))
        assert float(paid[first]) == pytest.approx(99.9, rel=1e-5) and not paid[first + 1 :].any()
        # The task still counts how far from the target it stays.
        assert float(row["next", "reward"][-1]) == pytest.approx(-4.0 * (0.47 - float(p[-1, 0])) ** 2, rel=1e-3)
    assert rows["next", "truncated"][:, -1].all() and not rows["next", "truncated"][:, :-1].any()


def test_a_step_from_another_state_is_refused():
    env = foreign_pendulum()
    now = env.reset().set("action", torch.zeros(1))
    env.step(now.clone())
    with pytest.raises(RuntimeError, match="reset"):
        env.step(now)
    with pytest.raises(RuntimeError, match="reset"):
        foreign_pendulum().step(now)


def test_an_episode_that_an_evaluation_has_taken_the_copies_of_is_refused():
    env = foreign_pendulum()
    now = env.reset().set("action", torch.zeros(1))
    env.with_task(env.task).reset()
    with pytest.raises(RuntimeError, match="reset"):
        env.step(now)
    env.step(env.reset().set("action", torch.zeros(1)))


def test_an_angle_instead_of_sine_and_cosine_moves_as_the_pendulum_by_hand():
    mapped = {"states": {"a": 1.0, "w": 8.0}, "observed": ["c", "s", "w"], "angles": {"a": ["s", "c"]}}
    env = environment("Pendulum-v1", {"a": 0.0}, inputs=["torque"], **mapped)
    assert env.system.signature.state_names == ("a", "w") and env.foreign.ends[1].tolist() == [math.inf, 8.0]
    starts = env.task.starts
    assert starts.shape == (256, 2) and starts[:, 0].abs().max() > 2.5  # the whole circle
    x = env.rollout(60, lambda td: td.set("action", torch.ones(1)))["next", "state"]
    a, w = torch.cat([x[:1], x]).unbind(-1)
    # Gymnasium's own step: the angle moves by the new speed times 0.05 s, over whole turns, too.
    torch.testing.assert_close(a[2:] - a[1:-1], 0.05 * w[2:], atol=1e-5, rtol=0)


NAMES = ["s", "w", "c", "unread"]


def shown(*angles):
    return torch.tensor([[math.sin(a), 0.1 * k, math.cos(a), 9.0] for k, a in enumerate(angles)])


def test_angles_and_their_rates_are_in_rad_unless_said_otherwise():
    mapped = {"states": ["a", "w"], "observed": ["c", "s", "w"], "angles": {"a": ["s", "c"]}, "rates": {"a": "w"}}
    assert Foreign("Pendulum-v1", **mapped).signature.state_units == ("rad", "rad/s")
    assert Foreign("Pendulum-v1", units=["turns", "-"], **mapped).signature.state_units == ("turns", "-")


def test_an_angle_goes_on_over_whole_turns_in_both_directions():
    observed = _Observed(NAMES, ["a", "w"], {"a": ["s", "c"]})
    for way in (1.0, -1.0):
        true = [way * 1.3 * k for k in range(12)]  # more than two turns, in steps of less than half a turn
        x = observed.state(shown(0.0))
        for angle in true[1:]:
            x = observed.state(shown(angle), x)
            assert x[0, 0].item() == pytest.approx(angle, abs=1e-5)
