"""Rate limits and play of inputs against the same thing in many small steps, and found where a plant has them."""

import numpy as np
import pytest
import torch

from dynasindy.sindy.actuators import Actuator, ActuatorFit, add_actuator, find_actuator
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.refinement import Refinement
from dynasindy.sindy.regression import Regression
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

DT, N, FINE, NOISE = 0.05, 400, 25, 0.01
MOTOR = Signature(("w",), ("rad/s",), ("u",), (2.0,))
PENDULUM = Signature(("angle", "w"), ("rad", "rad/s"), ("u",), (1.0, 4.0))


def _acting(kind: str, size: float, u: float, a: float, h: float) -> float:
    if kind == "rate limit":
        return a + np.clip(u - a, -size * h, size * h)
    if kind == "play":
        return np.clip(a, u - size, u + size)
    if kind == "dead zone":
        return u - np.clip(u, -size, size)
    return a + h / size * (u - a) if kind == "lag" else u


def _log(plant: Signature, kind: str, size: float, seed: int = 0) -> Transitions:
    """Return a motor, w' = -2 w + 5 a, or a pendulum, under random steps held for half a second, and noise."""
    rng = np.random.default_rng(seed)
    u, h = np.repeat(rng.uniform(-1, 1, N // 10), 10), DT / FINE
    a = angle = w = 0.0
    samples = [[angle, w]]
    for held in u:
        for _ in range(FINE):
            a = _acting(kind, size, held, a, h)
            rate = -9 * np.sin(angle) - 0.8 * w + 5 * a if plant is PENDULUM else -2 * w + 5 * a
            rate -= {"friction": size * np.tanh(40 * w), "drag": size * w * abs(w)}.get(kind, 0.0)
            w += h * rate
            angle += h * w
        samples.append([angle, w])
    y = np.array(samples)[:, -plant.n_x :] + NOISE * rng.normal(size=(N + 1, plant.n_x))
    return Transitions.from_trajectory(torch.from_numpy(y), torch.from_numpy(u)[:, None], DT)


def _model(plant: Signature, data: Transitions) -> SindyModel:
    words = ["1", "w", "u"] if plant is MOTOR else ["1", "w", "sin(angle)", "u"]
    known = {} if plant is MOTOR else {"angle": "w"}
    model = SindyModel(plant, words, Regression("bic"), Refinement("trajectory"), known=known)
    model.fit(data)
    return model


@pytest.mark.parametrize("plant", [MOTOR, PENDULUM])
@pytest.mark.parametrize(("kind", "size"), [("rate limit", 1.5), ("play", 0.15)])
def test_what_holds_an_actuator_back_is_found_with_its_size(plant, kind, size):
    data = _log(plant, kind, size)
    plain = _model(plant, data)
    found = find_actuator(plain, data)
    assert found.actuator is not None and (found.actuator.place, found.actuator.kind) == (0, kind)
    assert found.actuator.size == pytest.approx(size, rel=0.05)
    assert found.gain > 0.1
    names = plain.library.names
    gain, drag = (float(found.coefficients[names.index(name), -1]) for name in ("u", "w"))
    assert [gain, drag] == pytest.approx([5.0, -2.0 if plant is MOTOR else -0.8], rel=0.03)
    assert abs(float(plain.coefficients[names.index("u"), -1]) / 5 - 1) > 0.03  # which is why it matters


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    ("plant", "kind", "size"),
    [
        (MOTOR, "none", 0.0),
        (PENDULUM, "none", 0.0),
        # None of these is among the functions of the model.
        (MOTOR, "dead zone", 0.2),
        (MOTOR, "friction", 0.8),
        (MOTOR, "drag", 1.0),
        (MOTOR, "lag", 0.15),
    ],
)
def test_none_is_found_where_there_is_none(plant, kind, size, seed):
    data = _log(plant, kind, size, seed)
    plain = _model(plant, data)
    found = find_actuator(plain, data)
    assert found.actuator is None and found.sought
    assert found.coefficients is plain.coefficients
    with pytest.raises(ValueError, match="find_actuator"):
        add_actuator(plain, found, DT)


def test_a_recording_that_is_too_short_to_judge_is_not_looked_at():
    data = _log(MOTOR, "none", 0.0)
    short = data.select(torch.arange(N) < 200)
    assert not find_actuator(_model(MOTOR, data), short).sought


def test_none_is_looked_for_in_a_difference_equation():
    """Rate limits and play are told by what differential equations do within a sample."""
    model = SindyModel(MOTOR, ["1", "w", "u"], Regression("bic"), time="discrete")
    data = _log(MOTOR, "rate limit", 4.0)
    model.fit(data)
    found = find_actuator(model, data)
    assert found.actuator is None and not found.sought


def test_a_number_inside_a_function_is_the_one_that_was_fitted_behind_the_actuator():
    data = _log(PENDULUM, "play", 0.15)
    words = ["w", "sin(~1.2 angle)", "u"]
    plain = SindyModel(PENDULUM, words, Regression("bic"), Refinement("trajectory"), known={"angle": "w"})
    plain.fit(data)
    found = find_actuator(plain, data)
    before, after = (library.shapes[0].frequency for library in (plain.library, found.library))
    assert found.actuator is not None and after == pytest.approx(1.0, abs=0.03) and abs(after - before) > 1e-3
    model = add_actuator(plain, found, DT)
    path = model.simulate(torch.tensor([0.0, 0.0, float(data.u[0, 0])]).double(), data.u, DT, 5)
    assert float((path[1:, 0] - data.x_next[:, 0]).square().mean().sqrt()) < 5 * NOISE
    # The fitted equation, written down by hand: w' reads what play leaves of the command.
    value = dict(zip(found.library.names, found.coefficients[:, 1].tolist(), strict=True))
    sine = next(value[name] for name in value if "sin" in name)
    x, u = torch.tensor([0.7, 0.3, 0.2], dtype=torch.float64), torch.tensor([0.9], dtype=torch.float64)
    by_hand = sine * np.sin(after * 0.7) + value["w"] * 0.3 + value["u"] * 0.2
    assert float(model(x, u)[1]) == pytest.approx(by_hand, rel=1e-6)


def test_behind_a_rate_limit_a_step_is_a_ramp_and_behind_play_it_falls_short():
    plain = SindyModel(MOTOR, ["w", "u"])
    xi = torch.tensor([[-2.0], [5.0]], dtype=torch.float64)
    x, u = torch.zeros(2, dtype=torch.float64), torch.ones(1, dtype=torch.float64)
    limited, loose = (
        add_actuator(plain, ActuatorFit(Actuator(0, kind, size), xi, 0.5, "", plain.library), 0.025)
        for kind, size in (("rate limit", 1.5), ("play", 0.2))
    )
    assert limited.signature.state_names == ("w", "applied_u")
    assert limited(x, u).tolist() == pytest.approx([0.0, 1.5])
    # A hundredth of a second for each hundredth that the command is ahead: 2.5 / .025 s times 0.8, and 5 times 0.9.
    assert loose(x, u).tolist() == pytest.approx([0.0, 80.0])
    assert loose(torch.tensor([0.0, 0.9]).double(), u).tolist() == pytest.approx([4.5, 0.0])


def test_a_model_with_its_actuator_meets_the_plant_and_is_saved(tmp_path):
    data = _log(MOTOR, "rate limit", 1.5)
    plain = _model(MOTOR, data)
    found = find_actuator(plain, data)
    model = add_actuator(plain, found, DT)
    model.save(tmp_path / "model.json")
    again = SindyModel.load(tmp_path / "model.json")
    errors = {}
    for name, of in (("plain", plain), ("behind", again)):
        x0 = torch.tensor([0.0, float(data.u[0, 0])][: of.signature.n_x], dtype=torch.float64)
        path = of.simulate(x0, data.u, DT, 5)
        errors[name] = float((path[1:, 0] - data.x_next[:, 0]).square().mean().sqrt())
    assert errors["behind"] < 5 * NOISE and errors["plain"] > 2 * errors["behind"]


PERIOD, PARTS = 0.1, 1000


@pytest.mark.parametrize(("kind", "size"), [("rate limit", 4.1), ("play", 0.2), ("dead zone", 0.3), ("lag", 0.1)])
def test_the_mean_over_an_interval_is_that_of_small_steps(kind, size):
    u = np.random.default_rng(0).uniform(-1, 1, 60)
    a, expected = 0.0, []  # where it begins is not told
    for held in u:
        outputs = []
        for _ in range(PARTS):
            outputs.append(a := _acting(kind, size, held, a, PERIOD / PARTS))
        expected.append(np.mean(outputs))
    data = Transitions.from_trajectory(torch.zeros(61, 1).double(), torch.from_numpy(u)[:, None], PERIOD)
    found, known = Actuator(0, kind, size).acts(data)
    assert found.u[known, 0].numpy() == pytest.approx(np.array(expected)[known.numpy()], abs=4e-3)
    assert bool(known[20:].all()) and bool(known[0]) == (kind == "dead zone")
    assert found.x is data.x


def test_only_its_own_input_is_held_back_and_where_a_segment_begins_is_not_known():
    u = torch.tensor([[0.0, 0.0], [1.0, 1.0], [1.0, 1.0], [1.0, 1.0]], dtype=torch.float64)
    data = Transitions(torch.zeros(4, 1).double(), u, torch.zeros(4, 1).double(), 1.0, torch.tensor([0, 0, 0, 1]))
    # A unit a second, from 0 or from 1: at the end of the first second both ways are at 0; then from there to 1.
    found, known = Actuator(1, "rate limit", 1.0).acts(data)
    assert found.u.tolist() == [[0, 0.25], [1, 0.5], [1, 1], [1, 0.75]]
    assert known.tolist() == [False, True, True, False]
