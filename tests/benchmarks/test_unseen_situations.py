"""What is asked of policies in situations that they were not trained for."""

import torch
from benchmarks import unseen_situations

from dynasindy.envs import ControlEnv
from dynasindy.sensing import Observer, Sensing, Sensors
from dynasindy.systems import Xi
from dynasindy.tasks import Step, Tracking


def still(tensordict):
    return tensordict.set("action", torch.zeros(*tensordict.batch_size, 2))


def plant(observe_rate=False):
    return ControlEnv(Xi(), Tracking(Xi().signature, Step([[0.0, 0.0]]), observe_rate=observe_rate), dt=0.25)


def test_holding_flies_every_situation_within_and_beyond_its_box():
    noise = (1e-3,) * 6
    judged = list(unseen_situations.holding(plant(), still, (-0.4, -0.2), (0.4, 0.3), noise, 0))
    flown = {name: result for name, _, result, _ in judged}
    assert list(flown) == ["step", "edges", "beyond", "away", "noise_in_flight", "staircase"]
    assert {name: len(result.references) for name, result in flown.items()} == {
        **dict.fromkeys(("step", "away", "noise_in_flight"), 64), "edges": 16, "beyond": 16, "staircase": 1,
    }  # fmt: skip
    assert flown["step"].references.abs().amax() <= 0.4
    torch.testing.assert_close(flown["edges"].references.amax((0, 1)), torch.tensor([0.4, 0.3]))
    torch.testing.assert_close(flown["beyond"].references.amin((0, 1)), torch.tensor([-0.48, -0.25]))
    assert not flown["step"].trajectory["state"][:, 0].any() and flown["away"].trajectory["state"][:, 0].all()


def test_with_sensors_the_noise_is_what_the_observer_has_to_filter():
    env = plant()
    names = env.system.signature.state_names
    observer = Observer(Xi(), Sensors({name: {} for name in names[:2]}, rates={"alpha_a": "Omega_a"}), env)
    sensing, noise = Sensing(env, observer, torch.Generator().manual_seed(0)), (0.01, 0.03, 9.0, 9.0, 9.0, 9.0)
    flown = {
        name: result.trajectory
        for name, _, result, _ in unseen_situations.holding(env, still, (-0.4, -0.2), (0.4, 0.3), noise, 0, sensing)
    }
    errors = {name: (t["measurement"] - t["state"]).flatten(0, 1) for name, t in flown.items()}
    torch.testing.assert_close(errors["noise_in_flight"].std(0)[:2], torch.tensor(noise[:2]), rtol=0.05, atol=0)
    assert not errors["away"][:, :2].any() and errors["noise_in_flight"][:, 2:].isnan().all()


def test_each_stair_is_judged_by_its_end():
    *_, (name, _, result, errors) = unseen_situations.following(plant(observe_rate=True), still)
    assert name == "staircase" and errors.shape == (len(unseen_situations.LEVELS), 2)
    steps = round(unseen_situations.STAIR / 0.25)
    ends = result.outputs[0].reshape(len(unseen_situations.LEVELS), steps, 2)[
        :, -round(unseen_situations.HELD / 0.25) :
    ]
    wanted = (torch.tensor(unseen_situations.LEVELS).unsqueeze(1) - ends).abs().mean(1)
    torch.testing.assert_close(errors, wanted)
