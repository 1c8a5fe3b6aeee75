"""From samples of what moves in steps to equations in discrete time, and from these to a controller."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import dynasindy
from dynasindy.control import load, save
from dynasindy.sindy import Regression, SindyModel
from dynasindy.systems import Signature
from dynasindy.systems.transitions import Transitions

DT = 0.25


def following(a, b, u):
    """a+ = -0.6 a + 0.3 u + 0.2 b^2, b+ = 0.5 b - 0.4 a."""
    return -0.6 * a + 0.3 * u + 0.2 * b * b, 0.5 * b - 0.4 * a


def logged(folder, noise=0.0):
    """Write a log of the map under inputs that change every third step."""
    rng, (a, b), u, rows = np.random.default_rng(0), (0.0, 0.0), 0.0, ["time,a,b,u"]
    for k in range(500):
        u = rng.uniform(-1, 1) if k % 3 == 0 else u
        seen = np.array([a, b]) + noise * rng.standard_normal(2)
        rows.append(f"{DT * k},{seen[0]!r},{seen[1]!r},{u!r}".replace("np.float64(", "").replace(")", ""))
        a, b = following(a, b, u)
    (folder / "log.csv").write_text("\n".join(rows) + "\n")
    return dynasindy.read(folder / "log.csv")


def steps_of_the_map(n):
    """The map from random states under random inputs, n of its steps."""
    x, u = torch.rand(n, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64), torch.ones(n, 1).double()
    x_next = torch.stack(following(x[:, 0], x[:, 1], u[:, 0]), -1)
    return Transitions(x, u, x_next, DT, torch.arange(n))


def test_a_fit_that_fails_leaves_the_model_as_it_was():
    model = SindyModel(Signature(("a", "b"), ("-", "-"), ("u",), (1.0, 1.0)), ["a", "b", "u", "b^2"], time="discrete")
    with pytest.raises(ValueError, match="3 whole steps"):
        model.fit(steps_of_the_map(3))
    assert model.step == 0.0  # so the step is still that of the first data
    model.fit(steps_of_the_map(40))
    data = steps_of_the_map(30)
    before = model.equations(), model.step, model.samples
    errors = model.covariance.factor
    moved = model.predict(data.x, data.u, DT)
    with pytest.raises(ValueError, match="1 of 30 samples"):
        model.fit(replace(data, u=data.u.index_fill(0, torch.tensor(2), torch.inf)))
    assert (model.equations(), model.step, model.samples) == before and model.step == DT
    assert torch.equal(model.predict(data.x, data.u, DT), moved)
    assert torch.equal(model.covariance.factor, errors)


def pendulum(each):
    """A pendulum that takes so many steps of symplectic Euler in each of 300 samples of 20 ms."""
    u = np.repeat(np.random.default_rng(1).uniform(-1, 1, (30, 1)), 10, axis=0)
    h, x = 0.02 / each, [(2.0, 0.0)]
    for push in u[:, 0]:
        angle, speed = x[-1]
        for _ in range(each):
            speed += h * (20 * np.sin(angle) - 0.4 * speed + 4 * push)
            angle += h * speed
        x.append((angle, speed))
    return Transitions.from_trajectory(torch.tensor(x, dtype=torch.float64), torch.tensor(u), 0.02)


@pytest.mark.parametrize("each", [1, 100])
def test_a_plant_that_moves_in_steps_gets_difference_equations_by_itself(each):
    """What is known of rates, that the angle moves by the speed as it is, holds of the pendulum in time alone."""
    signature = Signature(("a", "w"), ("rad", "rad/s"), ("u",), (3.0, 8.0))
    made = {"library": ["a", "w", "sin(a)", "u"], "known": {"a": "w"}, "time": "auto"}
    made["regression"] = Regression("bic", tolerance=1e-4)
    model, data = SindyModel(signature, **made), pendulum(each)
    report = model.fit(data)
    assert [finding.code for finding in report.findings] == (["fit.steps"] if each == 1 else [])
    a, w = model.equations(3 if each == 1 else 2)
    if each == 1:
        assert model.step == 0.02 and w == "w[k+1] = 0.992 w + 0.4 sin(a) + 0.08 u"
    else:
        assert model.step is None and (a, w) == ("a' = w", "w' = -0.4 w + 20 sin(a) + 4 u")
    assert float((model.predict(data.x, data.u, 0.02, 4) - data.x_next).abs().max()) < 2e-3
    # Once it has chosen it stays with that, also in a copy that goes on from its state.
    again = SindyModel(signature, **made)
    again.load_state_dict(model.state_dict())
    other = again.fit(pendulum(100))
    assert (again.step is None) == (model.step is None) and "fit.steps" not in {each.code for each in other.findings}
    # A state of the other kind takes it back, to what is known, too.
    other = SindyModel(signature, **made)
    other.fit(pendulum(101 - each))
    other.load_state_dict(model.state_dict())
    assert other.equations() == model.equations() and torch.equal(other.constraints.free, model.constraints.free)
    assert other.fit(data).findings == () and other.equations() == model.equations()


def flown(controller, target, seen=lambda a, b: [a, b]):
    """What the map does under a controller from rest, the last of forty steps."""
    a = b = 0.0
    controller.reset()
    for _ in range(40):
        a, b = following(a, b, float(controller.act(seen(a, b), [target])[0]))
    return a


@pytest.mark.slow
def test_a_log_of_a_map_that_no_differential_equation_is_leads_to_a_controller_of_it(tmp_path):
    log = logged(tmp_path)
    model = dynasindy.identify(log, "polynomial", time="discrete")
    assert model.equations() == ["a[k+1] = -0.6 a + 0.3 u + 0.2 b^2", "b[k+1] = -0.4 a + 0.5 b"]
    controller = dynasindy.plan(model, {"a": (-0.1, 0.1)}, log=log, updates=150)
    assert controller.dt == DT and controller.observer is None  # what is exact needs none, however it jumps
    prediction = dynasindy.forecast(controller, model, log)
    assert prediction.controlled
    for target in (-0.08, 0.0, 0.08):
        assert flown(controller, target) == pytest.approx(target, abs=0.004)  # 2 % of the range
    with pytest.raises(ValueError, match=r"0\.25 s .* 0\.1 s"):
        dynasindy.plan(model, {"a": (-0.1, 0.1)}, dt=0.1)
    assert dynasindy.plan(model, {"a": (-0.1, 0.1)}, updates=1).dt == DT


def test_a_controller_with_an_observer_in_discrete_time_is_the_same_out_of_its_file(tmp_path):
    log = logged(tmp_path, noise=0.02)
    model = dynasindy.identify(log, "polynomial", time="discrete")
    controller = dynasindy.plan(model, {"a": (-0.1, 0.1)}, log=log, updates=2, rollouts=8, window=10)
    noise = controller.observer.variance[:2].sqrt()
    assert noise.tolist() == pytest.approx([0.02, 0.02], rel=0.2)
    save(controller, tmp_path / "controller.json")
    read, rng = load(tmp_path / "controller.json"), np.random.default_rng(1)
    assert read.observer.model.step == DT
    for _ in range(30):
        y = 0.1 * rng.standard_normal(2)
        assert read.act(y, [0.05]) == pytest.approx(controller.act(y, [0.05]), abs=1e-6)
