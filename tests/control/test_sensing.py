"""The real environment behind its sensors: what is shown, what is handed back, and that the truth is read by nobody."""

import math
from functools import partial

import pytest
import torch
from recipes import Heard, make_recipe, resumed
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torchrl.envs import Transform, TransformedEnv
from torchrl.envs.utils import check_env_specs

from dynasindy.agents import MEASURED_KEYS
from dynasindy.control import Observer
from dynasindy.control.sensing import Sensing
from dynasindy.dyna.callback import Callback
from dynasindy.dyna.experiment import LoopSettings
from dynasindy.dyna.loop import train
from dynasindy.envs import Chirp, ControlEnv, Multisine, Sensors, Step, Tracking, Wave
from dynasindy.evaluation.disturbances import PerturbedPlant, SensorNoise
from dynasindy.evaluation.scenarios import Scenario, evaluate
from dynasindy.planning import Gate, ImaginedReplay
from dynasindy.sindy import Oracle
from dynasindy.systems import Tras

COUNT = 2 * math.pi / 4096
BENCH = {
    "alpha_a": {"resolution": COUNT},
    "alpha_p": {"resolution": COUNT},
    "omega_a": {"noise": 20.0},
    "omega_p": {"noise": 20.0},
}
PERFECT = {name: {} for name in ("alpha_a", "alpha_p", "Omega_a", "Omega_p", "omega_a", "omega_p")}
KNOWN = {"alpha_a": "Omega_a", "alpha_p": "Omega_p"}


def behind(channels=None, task=None, **settings):
    plant = Tras()
    task = task or Tracking(plant.signature, Wave([0.3, 0.2], [0.5, 0.4]))
    env = ControlEnv(plant, task, substeps=2, dtype=torch.float64)
    sensors = Sensors(channels or BENCH, rates=KNOWN, **settings)
    sensing = Sensing(env, Observer(Tras(), sensors, env), torch.Generator().manual_seed(0))
    sensing.observer.nis = 1.0
    return env, sensing, TransformedEnv(env, sensing.on(env))


def chirp(steps=80):
    return Chirp(2, duration=steps * 0.05, dt=0.05, amplitude=[0.4, 0.3], offset=[0.0, 0.3])


@pytest.mark.parametrize("disturbance", [False, True])
@pytest.mark.parametrize("batch", [(), (4,)])
def test_specs_hold(batch, disturbance):
    plant = Tras()
    task = Tracking(plant.signature, Step([[0.1, 0.1]]))
    env = ControlEnv(plant, task, substeps=2, dtype=torch.float64, batch_size=batch)
    sensors = Sensors(BENCH, rates=KNOWN, delay=2, lost=0.1, actuator_delay=1, disturbance=disturbance)
    check_env_specs(TransformedEnv(env, Sensing(env, Observer(plant, sensors, env), torch.Generator().manual_seed(0))))


def test_the_plant_moves_as_it_does_without_sensors():
    env, _, sensed = behind(lost=0.2)
    bare, seen = env.rollout(80, chirp()), sensed.rollout(80, chirp())
    torch.testing.assert_close(seen["true_state"], bare["state"], rtol=0, atol=0)
    torch.testing.assert_close(seen["next", "true_state"], bare["next", "state"], rtol=0, atol=0)
    torch.testing.assert_close(seen["next", "true_reward"], bare["next", "reward"], rtol=0, atol=0)
    assert torch.equal(seen["next", "at_stop"], bare["next", "at_stop"])


def test_perfect_sensors_show_the_plant_as_it_is():
    env, _, sensed = behind(PERFECT)
    bare, seen = env.rollout(80, chirp()), sensed.rollout(80, chirp())
    for key in ("state", "observation", ("next", "state"), ("next", "observation"), ("next", "reward")):
        torch.testing.assert_close(seen[key], bare[key], rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(seen["next", "samples"], bare["next", "samples"], rtol=0, atol=0)
    torch.testing.assert_close(seen["measurement"], bare["state"], rtol=0, atol=0)


def test_measurements_are_the_last_samples_and_hold_what_the_bench_sees():
    _, _, sensed = behind()
    seen = sensed.rollout(80, chirp())
    samples, truth = seen["next", "samples"], seen["next", "true_state"]
    assert samples[..., 2:4].isnan().all() and not samples[..., [0, 1, 4, 5]].isnan().any()
    torch.testing.assert_close(seen["next", "measurement"], samples[:, -1], equal_nan=True)
    torch.testing.assert_close(seen["measurement"][1:], samples[:-1, -1], equal_nan=True)
    counts = samples[..., :2] / COUNT
    torch.testing.assert_close(counts, counts.round(), rtol=0, atol=1e-9)
    assert (samples[:, -1, :2] - truth[:, :2]).abs().max() <= COUNT / 2 + 1e-12
    assert 15 < (samples[:, -1, 4:] - truth[:, 4:]).std() < 25


def test_observation_and_reward_are_those_of_the_estimates():
    env, _, sensed = behind()
    for row in sensed.rollout(5, chirp()):
        t = row["step_count"].double() * 0.05
        x, x_next, params = row["state"], row["next", "state"], row["task_params"]
        torch.testing.assert_close(row["observation"], env.task.observation(x, params, t).float())
        reward = env.task.reward(x, x_next, params, t + 0.05, torch.tensor(False))
        assert row["next", "reward"].item() == pytest.approx(reward.item(), rel=1e-6)
        assert row["next", "reward"].item() != row["next", "true_reward"].item()


def test_an_episode_whose_estimates_become_the_truth_shows_and_earns_what_the_plant_itself_did():
    env, sensing, sensed = behind()
    bare = env.rollout(20, chirp())
    shown = sensing.reestimated(sensed.rollout(20, chirp()), torch.cat([bare["state"], bare["next", "state"][-1:]]))
    for key in ("state", "observation", ("next", "state"), ("next", "observation"), ("next", "reward")):
        torch.testing.assert_close(shown[key], bare[key], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("actuator", "late"), [(1, 0), (2, 0), (0, 2), (1, 1)])
def test_an_estimate_is_for_the_time_at_which_the_next_action_arrives(actuator, late):
    """A model that knows the delay sees the plant of `actuator` periods later, through sensors `late` periods late."""
    env, sensing, sensed = behind(PERFECT, actuator_delay=actuator, delay=late)
    sensing.observer.model.delay = actuator * env.dt
    seen = sensed.rollout(80, chirp())
    begun = 40
    expected = seen["true_state"][begun + actuator :]
    torch.testing.assert_close(seen["state"][begun : len(seen) - actuator], expected, rtol=1e-3, atol=1e-3)
    late_inputs = torch.cat([torch.zeros(actuator, 2), seen["action"]])[:80]
    samples, _ = env.advance(seen["true_state"], late_inputs.double())
    torch.testing.assert_close(samples[:, -1], seen["next", "true_state"], rtol=0, atol=0)


def test_an_estimate_beyond_all_sense_still_gives_numbers():
    class Exploding(Tras):
        def forward(self, x, u):
            return 30.0 * x + 1.0  # from rest by e^120 in 80 periods

    env, sensing, _ = behind({"alpha_a": {}})
    wild = Sensing(env, Observer(Exploding(), sensing.sensors, env), torch.Generator().manual_seed(0))
    wild.observer.nis = 1.0
    rollout = TransformedEnv(env, wild.on(env)).rollout(80, chirp())
    scale = torch.tensor(Tras().signature.x_scale, dtype=torch.float64)
    assert float((rollout["next", "state"] / scale).abs().max()) <= 1e4 * (1 + 1e-12)
    for key in ("state", "observation", "reward"):
        assert rollout["next", key].isfinite().all(), key


def test_rows_of_a_batch_are_those_of_single_episodes():
    env, sensing, sensed = behind()
    starts = torch.tensor([[0.1, 0.2, 0.0, 0.0, 0.0, 0.0], [-0.3, 0.0, 0.1, 0.0, 500.0, 0.0]]).double()
    policy = TensorDictModule(lambda o: o[..., :2] * 0.5, in_keys=["observation"], out_keys=["action"])
    quiet = Sensors({name: {"resolution": COUNT} for name in ("alpha_a", "alpha_p")}, rates=KNOWN)
    sensing.observer = Observer(Tras(), quiet, env)
    sensed = TransformedEnv(env, sensing.on(env))

    def fly(x):
        torch.manual_seed(0)
        env.set_seed(0)
        return sensed.rollout(
            20, policy, auto_reset=False, tensordict=sensing.begin(env.start_from(x)), break_when_any_done=False
        )

    both, first = fly(starts), fly(starts[:1])
    torch.testing.assert_close(both["state"][:1], first["state"], rtol=1e-9, atol=1e-9)
    assert not torch.equal(both["state"][0], both["state"][1])


TRUTH = ("true_state", "true_reward")


class Blind(Transform):
    """Replace the truth by NaN wherever anything downstream could see it, and hand it back to the plant."""

    def __init__(self):
        super().__init__(in_keys=[], out_keys=[])

    def _hide(self, shown: TensorDictBase) -> TensorDictBase:
        self.kept = {key: shown[key] for key in TRUTH}
        return shown.update({key: torch.full_like(shown[key], math.nan) for key in TRUTH})

    def _step(self, tensordict, next_tensordict):
        return self._hide(next_tensordict)

    def _reset(self, tensordict, tensordict_reset):
        return self._hide(tensordict_reset)

    def _inv_call(self, tensordict):
        return tensordict.update(self.kept) if "action" in set(tensordict.keys()) else tensordict


class Learner(Oracle):
    """A model that remembers what it was fitted to."""

    def fit(self, transitions):
        self.seen = [*getattr(self, "seen", []), transitions]
        return super().fit(transitions)


def recipe(seed=0, sensors=None):
    plant = Tras()
    return make_recipe(
        plant,
        30,
        env=partial(ControlEnv, substeps=1, dtype=torch.float64),
        excitation=partial(Multisine, duration=1.5),
        world_model=partial(Learner, system=Tras()),
        planning=partial(ImaginedReplay, rollouts=4, horizon=5),
        gate=Gate(math.inf, math.inf),
        train=LoopSettings(2, 0.2),
        sensors=sensors or Sensors(BENCH, rates=KNOWN, lost=0.05, actuator_delay=1),
        seed=seed,
    )


def same(one, other):
    """Whether two nests of containers and tensors agree, NaN equal to itself."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, torch.Tensor):
        return torch.equal(one.isnan(), other.isnan()) and torch.equal(one.nan_to_num(), other.nan_to_num())
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other or one is other or (one != one and other != other)


def test_a_run_that_cannot_see_the_truth_is_the_same_run():
    def trained(blind):
        made, heard = recipe(), Heard()
        parts = made.build()
        if blind:
            parts.env = TransformedEnv(parts.env, Blind(), auto_unwrap=False)
        train(parts, made.train, heard)
        return parts, heard

    (open_, heard), (blind, told) = trained(False), trained(True)
    assert told.episodes[0].rollout["true_state"].isnan().all()
    assert not heard.episodes[0].rollout["true_state"].isnan().any()
    assert same(open_.state_dict(), blind.state_dict())
    for one, other in zip(open_.world_model.seen, blind.world_model.seen, strict=True):
        assert same([one.x, one.u, one.x_next, one.segment], [other.x, other.u, other.x_next, other.segment])
        assert one.x[:, 2:4].isnan().all() and not one.x.isnan().all()
    for one, other in zip(heard.episodes, told.episodes, strict=True):
        assert same([one.error.state_error, one.error.states], [other.error.state_error, other.error.states])
        assert same(
            [one.one_step.reward_error, one.one_step.states], [other.one_step.reward_error, other.one_step.states]
        )
        assert all(same(one.rollout[key], other.rollout[key]) for key in MEASURED_KEYS)


def test_a_run_resumed_at_any_place_is_the_uninterrupted_one():
    made = recipe(sensors=Sensors(BENCH, rates=KNOWN, lost=0.05, actuator_delay=1, disturbance=True))
    heard = Heard(whole := made.build())
    train(whole, made.train, heard)
    for place in heard.states[:-1]:
        assert same(resumed(made, *place).state_dict(), whole.state_dict())


def test_after_the_first_fit_the_observer_relies_on_the_model_and_the_excitation_is_estimated_anew():
    parts = recipe(sensors=Sensors(BENCH, rates=KNOWN)).build()
    excited = parts.env.rollout(30, parts.excitation)
    assert not parts.sensing.observer.learnt
    before = (excited["next", "state"] - excited["next", "true_state"])[:, 2:4].square().mean()
    parts = recipe(sensors=Sensors(BENCH, rates=KNOWN)).build()
    train(parts, LoopSettings(0), Callback())
    stored = parts.replay.real_in_order()
    after = (stored["next", "state"] - excited["next", "true_state"])[:, 2:4].square().mean()
    assert parts.sensing.observer.learnt and after < 0.01 * before
    assert torch.equal(stored["state"][1:], stored["next", "state"][:-1])


def policy():
    return TensorDictModule(lambda o: torch.tanh(o[..., 6:8]), in_keys=["observation"], out_keys=["action"])


@pytest.mark.parametrize(
    "changes", [{}, {"plant": partial(PerturbedPlant, gain={"Omega_a": 0.9}), "windows": [(0.5, 1.0)]}]
)
def test_an_evaluation_flies_by_estimates_and_is_judged_by_the_truth(changes):
    env, sensing, _ = behind()
    scenario = Scenario("s", Step([[0.3, 0.2], [0.1, -0.1]]), 2, 2.0, **changes)
    before = sensing.rng.get_state()
    seen = evaluate(env, policy(), scenario, sensing.observer)
    assert torch.equal(before, sensing.rng.get_state())
    assert same(seen.trajectory["action"], evaluate(env, policy(), scenario, sensing.observer).trajectory["action"])

    def blind(tensordict):
        hidden = tensordict.copy().update({key: tensordict[key] * math.nan for key in TRUTH})
        return tensordict.set("action", policy()(hidden)["action"])

    assert same(evaluate(env, blind, scenario, sensing.observer).trajectory["action"], seen.trajectory["action"])
    told, truth = seen.trajectory["estimate"], seen.trajectory["true_state"]
    torch.testing.assert_close(
        seen.trajectory["observation"][..., :6], (told / torch.tensor(env.system.signature.x_scale)).float()
    )
    assert torch.equal(seen.outputs, truth[..., :2]) and not torch.equal(told, truth)
    assert torch.equal(seen.returns, seen.trajectory["next", "true_reward"].sum((-1, -2)))
    exact = evaluate(env, policy(), scenario)
    assert 0 < (seen.outputs - exact.outputs).abs().max() < 0.02


def test_noise_of_a_scenario_is_of_the_measurement_and_the_observer_filters_it():
    env, sensing, _ = behind()
    sensing.observer.q.fill_(1e-2)  # it relies on its model, which is the plant
    std, saw, believed = [0.02, 0.0, 0.3, 0.3, 150.0, 0.0], [], sensing.observer.variance.clone()
    named = dict(zip(env.system.signature.state_names, std, strict=True))

    def keeping(tensordict):
        saw.append(tensordict["state"].clone())
        return policy()(tensordict)

    scenario = Scenario("s", Step([[0.3, 0.2]]), 16, 3.0, wrappers=[partial(SensorNoise, std=named)])
    flown = evaluate(env, keeping, scenario, sensing.observer).trajectory
    error = (flown["measurement"] - flown["true_state"]).flatten(0, 1)
    # Independent errors add in squares: what the bench has, and what the scenario adds; rates are not measured.
    rounding = COUNT / math.sqrt(12)
    wanted = [math.hypot(rounding, 0.02), rounding, math.nan, math.nan, math.hypot(20.0, 150.0), 20.0]
    torch.testing.assert_close(error.std(0), torch.tensor(wanted).double(), rtol=0.1, atol=0, equal_nan=True)
    # The policy sees nothing but the estimate, which is better than what was measured.
    seen = torch.stack([x for x in saw if len(x) == 16][-60:], 1)
    assert torch.equal(seen, flown["estimate"]) and torch.equal(sensing.observer.variance, believed)
    assert 0 < float((seen - flown["true_state"])[:, 20:, 4].std()) < 0.8 * wanted[4]
    quiet = Scenario("s", Step([[0.3, 0.2]]), 16, 3.0, wrappers=[partial(SensorNoise, std={})])
    without = Scenario("s", Step([[0.3, 0.2]]), 16, 3.0)
    flights = [evaluate(env, policy(), each, sensing.observer).trajectory["true_state"] for each in (quiet, without)]
    assert torch.equal(*flights)
