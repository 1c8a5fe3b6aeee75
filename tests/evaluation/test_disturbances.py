"""Disturbances against the plant's own equations and against hand-made policies."""

import pytest
import torch
from alternating import Alternating
from tensordict import TensorDict, TensorDictBase

from dynasindy.envs import ControlEnv, Step, Tracking, Wave
from dynasindy.evaluation.disturbances import DelayedActuator, PerturbedPlant, SensorNoise
from dynasindy.systems import Tras, Xi, integrate

X = torch.rand(4, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
U = torch.rand(4, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(1))


def make() -> ControlEnv:
    system = Tras()
    return ControlEnv(system, Tracking(system.signature, Step([[0.3, 0.2]])))


def test_a_push_adds_its_acceleration_and_nothing_else() -> None:
    change = PerturbedPlant(Xi(), {"Omega_p": -0.5})(X, U) - Xi()(X, U)
    expected = torch.tensor([0, 0, 0, -0.5, 0, 0], dtype=torch.float64).expand(4, 6)
    torch.testing.assert_close(change, expected)


def test_detuning_scales_accelerations_and_inputs() -> None:
    detuned = PerturbedPlant(Xi(), gain={"Omega_a": 0.9}, input_gain=[1.0, 0.8])(X, U)
    expected = Xi()(X, U * torch.tensor([1.0, 0.8], dtype=torch.float64))
    expected[:, 2] *= 0.9
    torch.testing.assert_close(detuned, expected)


def test_disturbed_plants_keep_stops_and_dtype() -> None:
    for plant in (PerturbedPlant(Tras(), {"Omega_a": 1.0}), PerturbedPlant(Tras(), gain={})):
        assert plant.stops == Tras().stops
        assert plant(X.float(), U.float()).dtype == torch.float32


def test_noise_reaches_the_policy_at_the_present_time_and_not_the_plant() -> None:
    system, seen = Tras(), []
    env = ControlEnv(system, Tracking(system.signature, Wave([0.3, 0.2], [0.5, 0.4])))

    def policy(td: TensorDictBase) -> TensorDictBase:
        seen.append(td.clone())
        return td.set("action", torch.full((*td.batch_size, 2), 0.4))

    std = [0.01, 0.02, 0.0, 0.0, 50.0, 0.0]
    start = env.start_from(torch.zeros(2000, 6))
    start["step_count"] = torch.arange(2000).unsqueeze(-1) % 30
    true = start.clone()
    named = dict(zip(system.signature.state_names, std, strict=True))
    out = SensorNoise(policy, env, named, seed=3)(start)
    torch.testing.assert_close(out["state"], true["state"])
    torch.testing.assert_close(out["observation"], true["observation"])
    assert bool((out["action"] == 0.4).all())
    torch.testing.assert_close(seen[0]["state"].std(0), torch.tensor(std), rtol=0.05, atol=0)
    # The observation is made of the noisy state: scaled states first, then errors over 0.5 rad.
    wanted = 0.3 * torch.sin(2 * torch.pi * 0.5 * 0.05 * true["step_count"][:, 0])
    torch.testing.assert_close(seen[0]["observation"][:, 4], seen[0]["state"][:, 4] / 4000)
    torch.testing.assert_close(seen[0]["observation"][:, 6], (wanted - seen[0]["state"][:, 0]) / 0.5)
    again = SensorNoise(policy, env, named, seed=3)
    again(true)
    torch.testing.assert_close(seen[0]["state"], seen[1]["state"], rtol=0, atol=0)


@pytest.mark.parametrize("periods", [0, 1, 3])
def test_a_delay_shifts_the_actions(periods: int) -> None:
    wrapped = DelayedActuator(lambda td: td.set("action", td["step_count"] + 1.0), make(), periods)
    steps = [TensorDict({"step_count": torch.tensor([k])}, []) for k in range(6)]
    actions = [wrapped(td)["action"].item() for td in steps]
    assert actions == [0.0] * periods + [k + 1.0 for k in range(6 - periods)]


def test_noise_comes_from_the_sensors_of_a_plant_and_else_from_its_ranges() -> None:
    env = ControlEnv(Tras(), Tracking(Tras().signature, Step([[0.0, 0.0]])))
    sensors = {"alpha_a": {"resolution": 0.006}, "omega_a": {"noise": 30.0}, "Omega_p": {}}
    # A rounding to steps of q errs by q over the root of 12; ranges are 1 rad, 1 rad/s, 4000 and 2500 rpm.
    wanted = [0.006 / 12**0.5, 0.001, 0.001, 0.001, 30.0, 2.5]
    assert SensorNoise(lambda td: td, env, sensors=sensors).std.tolist() == pytest.approx(wanted)
    named = SensorNoise(lambda td: td, env, {"Omega_a": 0.02, "omega_p": 20.0})
    assert named.std.tolist() == pytest.approx([0.0, 0.0, 0.02, 0.0, 0.0, 20.0])
    with pytest.raises(ValueError, match="0 or more"):
        SensorNoise(lambda td: td, env, {"omega_p": -0.1})


def test_a_plant_in_discrete_time_is_pushed_and_detuned_in_its_steps():
    """x+ = x + h (gain f + push) of f = (-1.6 x + u) / h: with a gain of 0.5 and a push of 0.2 from 1 under 0.1."""
    x, u = torch.tensor([[1.0]], dtype=torch.float64), torch.tensor([[0.1]], dtype=torch.float64)
    for plant, end in (
        (PerturbedPlant(Alternating(), gain={"x": 0.5}), 1.0 + 0.5 * (-1.6 + 0.1)),
        (PerturbedPlant(Alternating(), {"x": 0.2}), -0.6 + 0.1 + 0.5 * 0.2),
    ):
        assert float(integrate(plant, x, u, 0.5, 1)[0][..., -1, :]) == pytest.approx(end, rel=1e-12)
