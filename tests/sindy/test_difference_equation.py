"""Difference equations: known maps are found exactly, saved, refused where they do not hold, and found behind noise."""

import json
from dataclasses import replace

import pytest
import torch

from dynasindy.envs import ControlEnv, Step, Tracking, TrackingReward
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.world_model import nrmse, one_step_error, open_loop
from dynasindy.systems import Signature
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("a", "b"), ("-", "-"), ("u",), (1.0, 1.0))
TRUE = {("a", "a"): -0.6, ("a", "u"): 0.3, ("a", "b^2"): 0.2, ("b", "b"): 0.5, ("b", "a"): -0.4}
DT = 0.1


def mapped(x, u):
    """a+ = -0.6 a + 0.3 u + 0.2 b^2, b+ = 0.5 b - 0.4 a, of lists of numbers."""
    return [-0.6 * x[0] + 0.3 * u + 0.2 * x[1] ** 2, 0.5 * x[1] - 0.4 * x[0]]


def trajectory(n=400, seed=0, pushed=0.0, late=0):
    """States and inputs of the map, which random pushes move, too, and whose inputs act some steps late."""
    rng = torch.Generator().manual_seed(seed)
    u = (2 * torch.rand(n, 1, generator=rng, dtype=torch.float64) - 1).tolist()
    pushes = (pushed * torch.randn(n, 2, generator=rng, dtype=torch.float64)).tolist()
    x = [[0.1, -0.2]]
    for k in range(n):
        after = mapped(x[-1], u[k - late][0] if k >= late else 0.0)
        x.append([value + push for value, push in zip(after, pushes[k], strict=True)])
    return torch.tensor(x, dtype=torch.float64), torch.tensor(u, dtype=torch.float64)


def data_of(x, u, noise=0.0, seed=1, dt=DT):
    rng = torch.Generator().manual_seed(seed)
    return Transitions.from_trajectory(x + noise * torch.randn(x.shape, generator=rng, dtype=x.dtype), u, dt)


def identified(data, method="auto", time="discrete", library="polynomial", **more):
    model = SindyModel(SIGNATURE, library, Regression("bic", tolerance=1e-4), Refinement(method, **more), time=time)
    return model, model.fit(data)


def right_sides(model):
    """The coefficients of x[k+1] that are not zero, by state and function."""
    found = {}
    for i, state in enumerate(SIGNATURE.state_names):
        for k, name in enumerate(model.library.names):
            value = model.step * float(model.coefficients[k, i]) + (name == state)
            if abs(value) > 1e-9:
                found[state, name] = value
    return found


@pytest.mark.parametrize("method", ["integral", "one_step", "trajectory", "auto"])
def test_the_coefficients_of_a_known_map_are_exact(method):
    model, report = identified(data_of(*trajectory()), method)
    assert model.step == DT
    assert right_sides(model) == pytest.approx(TRUE, rel=1e-9)
    assert model.equations() == ["a[k+1] = -0.6 a + 0.3 u + 0.2 b^2", "b[k+1] = -0.4 a + 0.5 b"]
    assert max(report.residual.values()) < 1e-12 and "a[k+1] - a[k]: 3 terms" in report.to_text()


def test_no_differential_equation_does_what_a_negative_eigenvalue_does():
    """e^(A dt) of a real A is positive; -0.6 a is none, so the best such model misses most of it, or diverges."""
    training, fresh = data_of(*trajectory()), data_of(*trajectory(seed=7))
    discrete, continuous = (identified(training, time=time)[0] for time in ("discrete", "continuous"))
    assert float(one_step_error(discrete, fresh).max()) < 1e-12
    assert not float(one_step_error(continuous, fresh, 10)[0]) <= 0.2
    assert float(nrmse(open_loop(discrete, fresh), fresh).max()) < 1e-12
    assert not float(nrmse(open_loop(continuous, fresh, 10), fresh)[0]) <= 0.2


def test_a_file_and_a_checkpoint_hold_the_step(tmp_path):
    model, _ = identified(data_of(*trajectory()))
    model.save(tmp_path / "model.json")
    record = json.loads((tmp_path / "model.json").read_text())
    assert record["step"] == DT and record["equations"][1] == "b[k+1] = -0.4 a + 0.5 b"
    read = SindyModel.load(tmp_path / "model.json")
    other = SindyModel(SIGNATURE, "polynomial", time="discrete")
    other.load_state_dict(model.state_dict())
    x, u = torch.tensor([[0.3, -0.7]], dtype=torch.float64), torch.tensor([[0.4]], dtype=torch.float64)
    for same in (read, other):
        assert same.step == DT and same.equations() == model.equations()
        assert same.predict(x, u, DT)[0].tolist() == pytest.approx(mapped([0.3, -0.7], 0.4), rel=1e-12)
    record["step"] = -1.0
    (tmp_path / "model.json").write_text(json.dumps(record))
    with pytest.raises(ValueError, match=r"-1\.0 s"):
        SindyModel.load(tmp_path / "model.json")


def test_a_period_of_parts_of_the_step_is_refused_and_one_of_whole_steps_holds_the_input():
    model, _ = identified(data_of(*trajectory()))
    x, u = torch.tensor([[0.3, -0.7]], dtype=torch.float64), torch.tensor([[0.4]], dtype=torch.float64)
    twice = mapped(mapped([0.3, -0.7], 0.4), 0.4)
    assert model.predict(x, u, 2 * DT, 5)[0].tolist() == pytest.approx(twice, rel=1e-12)
    task = Tracking(SIGNATURE, Step([[0.1]]), ["a"], [], TrackingReward([1.0]), max_steps=5)
    env = ControlEnv(model, task, 0.15, 1, dtype=torch.float64)
    with pytest.raises(ValueError, match=r"env\.dt=0\.1"):
        env.rollout(2)
    assert model.fit(data_of(*trajectory(), dt=0.2)).dt == model.step == 0.2  # a fit forgets all that was


def test_neither_noise_of_the_sensors_nor_pushes_bend_the_equations():
    """Single steps of noisy samples shrink the coefficients: of b by R / (R + Var b). Whole simulations do not."""
    x, u = trajectory(1000)
    noisy = data_of(x, u, 0.05)
    (naive, _), (model, _) = identified(noisy, "one_step"), identified(noisy, "trajectory")
    found, shrunk = right_sides(model), right_sides(naive)
    assert shrunk["b", "b"] < 0.35
    assert found["b", "b"] == pytest.approx(0.5, abs=0.05) and found["b", "a"] == pytest.approx(-0.4, abs=0.03)
    assert found["a", "a"] == pytest.approx(-0.6, abs=0.04) and found["a", "u"] == pytest.approx(0.3, abs=0.01)
    pushed, report = identified(data_of(*trajectory(1000, pushed=0.05)))
    assert [finding.code for finding in report.findings] == ["fit.single_steps"]
    found = right_sides(pushed)
    assert {key: found[key] for key in TRUE if key != ("a", "b^2")} == pytest.approx(
        {key: value for key, value in TRUE.items() if key != ("a", "b^2")}, abs=0.03
    )


@pytest.mark.parametrize("method", ["integral", "one_step", "trajectory"])
def test_inputs_that_seem_to_act_a_part_of_a_step_late_act_whole_steps_late(method):
    """b[k+1] = 0.5 b[k] + 0.7 u[k-2] + 0.3 u[k-3]: by a mean of both inputs the delay would be 2.3 steps."""
    u = (2 * torch.rand(400, 1, generator=torch.Generator().manual_seed(4), dtype=torch.float64) - 1).tolist()
    b = [[0.1]]
    for k in range(400):
        late = 0.7 * u[k - 2][0] + 0.3 * u[k - 3][0] if k > 2 else 0.0
        b.append([0.5 * b[-1][0] + late])
    data = Transitions.from_trajectory(*(torch.tensor(rows, dtype=torch.float64) for rows in (b, u)), DT)
    signature = Signature(("b",), ("-",), ("u",), (1.0,))
    model = SindyModel(signature, ["b", "u"], Regression("bic"), Refinement(method, longest_delay=0.5), time="discrete")
    model.fit(data)
    assert model.delay == pytest.approx(2 * DT, abs=1e-12)


DATA = Transitions.from_trajectory(torch.arange(20.0, dtype=torch.float64).reshape(10, 2), torch.zeros(9, 1), 0.25)


def test_samples_within_a_control_period_are_left_out():
    """Both states grow by 6 in three samples, and b is larger than a by 1."""
    model = SindyModel(SIGNATURE, ["a", "b", "u"], Regression("bic"), time="discrete")
    report = model.fit(replace(DATA, substeps=3))
    assert model.step == 0.75 and report.samples == 3
    after = model.predict(torch.tensor([[0.0, 1.0], [9.0, 10.0]]).double(), torch.zeros(2, 1).double(), 0.75)
    assert after.flatten().tolist() == pytest.approx([6.0, 7.0, 15.0, 16.0])
