"""The control step as ONNX flies plants behind sensors as the controller in Python does; so does the policy."""

import importlib.util
import math

import numpy as np
import pytest
import torch
from controllers import oven_controller, pendulum_controller, rotor_controller

from dynasindy.export.onnx import controller_onnx, policy_onnx
from dynasindy.systems import Pendulum, Tras

onnx = pytest.importorskip("onnx", reason="onnx is not installed: pip install -e '.[export]'")
runtime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: pip install -e '.[export]'")

spec = importlib.util.spec_from_file_location("flights_in_c", __file__.replace("test_onnx", "test_c_code"))
assert spec is not None and spec.loader is not None
flights_in_c = importlib.util.module_from_spec(spec)
spec.loader.exec_module(flights_in_c)


class Step:
    """A control step out of its file, and what it remembers."""

    def __init__(self, path):
        options = runtime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = runtime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        self.reset()

    def reset(self):
        self.state = np.zeros(self.session.get_inputs()[0].shape)

    def act(self, y, r, rate):
        given = zip(("measurement", "reference", "rate"), (y, r, rate), strict=True)
        fed = {"state": self.state} | {name: np.array(values, dtype=np.float64) for name, values in given}
        u, self.state = self.session.run(["u", "next_state"], fed)
        return u


def written(controller, tmp_path):
    path = tmp_path / "controller.onnx"
    controller_onnx(controller, path)
    onnx.checker.check_model(str(path), full_check=True)
    assert b".py" not in path.read_bytes(), "the file tells where in our code a node is from"
    return Step(path)


SHORT = {"step": 0.04, "delay": 0.0, "stops": False}
"""Settings of a controller whose observer takes one step a period, of which the exporter writes few operations."""


def long(settings):
    """Whether an observer looks far ahead, of which the exporter writes thousands of operations."""
    return bool(settings) and settings.get("observer", True) and settings.get("step") != 0.04


@pytest.mark.parametrize(
    "settings",
    [
        pytest.param(kind, marks=pytest.mark.slow) if long(kind) else kind
        for kind in flights_in_c.KINDS
        if not long(kind) or "integral" in kind or "step" in kind
    ],
    ids=str,
)
def test_it_flies_a_pendulum_as_python_does(settings, tmp_path):
    controller = pendulum_controller(**settings)
    assert flights_in_c.apart(controller, written(controller, tmp_path).act, Pendulum(), 1) < 1e-6


@pytest.mark.slow
def test_it_flies_two_rotors_as_python_does(tmp_path):
    controller = rotor_controller({"band": 0.5, "gain": 2.0}, damped=["Omega_a", None])
    assert flights_in_c.apart(controller, written(controller, tmp_path).act, Tras(), 2) < 1e-6


@pytest.mark.parametrize("pushed", [True, False])
def test_a_store_that_nobody_measures_begins_at_80_degrees_as_in_python(pushed, tmp_path):
    controller = oven_controller(pushed)
    expected = flights_in_c.from_hot(flights_in_c.by_torch(controller).act, controller)
    found = flights_in_c.from_hot(written(controller, tmp_path).act, controller)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_the_file_says_what_goes_in_and_comes_out(tmp_path):
    told = written(pendulum_controller(**SHORT), tmp_path).session.get_modelmeta().custom_metadata_map
    assert (told["reference"], told["measurement"], told["period"]) == ("theta", "theta, Omega", "0.04 s")
    # 1 input, 3 states with 9 covariances, two inputs more than the one period of delay, 3 of the shift
    assert "units of u" not in told
    assert told["state"] == f"{1 + 3 + 9 + 3 + 3} numbers, zeros at the start"


def test_each_call_is_that_of_python_also_where_samples_are_lost_or_wild_or_no_action_follows(tmp_path):
    controller = pendulum_controller(integral={"band": 0.9}, **SHORT)
    step, rng, last, refused = written(controller, tmp_path), np.random.default_rng(7), np.zeros(1), 0
    for k in range(60):
        y = [0.1 * math.sin(0.3 * k) + 0.01 * rng.standard_normal(), math.nan]
        r, rate = [0.2 * math.cos(0.2 * k)], [0.1]
        y[0] = {20: math.nan, 21: math.inf, 30: 1e200, 40: 5.0}.get(k, y[0])
        r[0] = math.nan if k == 25 else r[0]
        try:
            expected = controller.act(y, r, rate)
        except ValueError:
            refused, expected = refused + 1, last
        last = step.act(y, r, rate)
        np.testing.assert_allclose(last, expected, rtol=0, atol=1e-5, err_msg=f"call {k}")
    assert refused >= 2


def test_where_a_model_explodes_it_begins_anew_as_in_python(tmp_path):
    controller = pendulum_controller(**SHORT)
    controller.observer.model.set_coefficients(controller.observer.model.coefficients * -400.0)
    step = written(controller, tmp_path)
    for k in range(10):
        y = [0.4 * math.sin(k), math.nan]
        np.testing.assert_allclose(step.act(y, [0.3], [0.0]), controller.act(y, [0.3]), atol=1e-5, err_msg=f"call {k}")


def test_onnxruntime_acts_as_the_policy(tmp_path):
    controller = pendulum_controller()
    policy_onnx(controller, tmp_path / "policy.onnx")
    onnx.checker.check_model(str(tmp_path / "policy.onnx"), full_check=True)
    graph = onnx.load(str(tmp_path / "policy.onnx"))
    assert (graph.ir_version, [each.version for each in graph.opset_import]) == (8, [17])  # of 2022
    session = runtime.InferenceSession(str(tmp_path / "policy.onnx"), providers=["CPUExecutionProvider"])
    seen = torch.from_numpy(np.random.default_rng(0).standard_normal((50, 4)).astype(np.float32))
    (found,) = session.run(["action"], {"observation": seen.numpy()})
    expected = controller.network(seen.clone()).numpy()
    assert expected.std() > 0.05
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    told = session.get_modelmeta().custom_metadata_map
    assert told["action"] == "u" and told["observation"] == (
        "theta / 1.5, Omega / 3.0, (theta wanted - theta) / 0.7, rate of theta wanted / 1.4"
    )
