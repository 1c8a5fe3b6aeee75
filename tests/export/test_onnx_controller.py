"""The control step as ONNX flies plants behind sensors as the controller in Python does."""

import importlib.util
import math
from dataclasses import replace

import numpy as np
import pytest

from dynasindy.export.onnx_controller import controller_onnx
from dynasindy.systems import Pendulum, Tras

onnx = pytest.importorskip("onnx", reason="onnx is not installed: pip install -e '.[export]'")
runtime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: pip install -e '.[export]'")

spec = importlib.util.spec_from_file_location("flights_in_c", __file__.replace("onnx_controller", "c_controller"))
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
    return Step(path)


@pytest.mark.parametrize("settings", flights_in_c.KINDS, ids=str)
def test_it_flies_a_pendulum_as_python_does(pendulum, settings, tmp_path):
    controller = pendulum(**settings)
    assert flights_in_c.apart(controller, written(controller, tmp_path).act, Pendulum(), 1) < 1e-6


@pytest.mark.parametrize("damped", [["Omega_a", "Omega_p"], ["Omega_a", None]])
@pytest.mark.parametrize("integral", [None, {"band": 0.5, "gain": 2.0}])
def test_it_flies_two_rotors_as_python_does(rotors, integral, damped, tmp_path):
    controller = rotors(integral, damped=damped)
    assert flights_in_c.apart(controller, written(controller, tmp_path).act, Tras(), 2) < 1e-6


@pytest.mark.parametrize("pushed", [True, False])
def test_a_store_that_nobody_measures_begins_at_80_degrees_as_in_python(oven, pushed, tmp_path):
    controller = oven(pushed)
    expected = flights_in_c.from_hot(controller.act, controller)
    found = flights_in_c.from_hot(written(controller, tmp_path).act, controller)
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("seed", range(2))
def test_broken_samples_are_answered_as_in_python_call_by_call(pendulum, seed, tmp_path):
    controller = pendulum(integral={"gain": 3.0}, delay=0.0, stops=False)
    readings, u = flights_in_c.glitched(controller, seed), np.zeros(1)
    expected = flights_in_c.answers(controller.act, readings, [0.1])
    step = written(controller, tmp_path)
    for y, answer in zip(readings, expected, strict=True):
        u = u if answer is None else answer  # a call that is refused returns what the one before did
        np.testing.assert_allclose(step.act(y, [0.1], [0.0]), u, atol=1e-6)


def test_what_is_no_number_changes_nothing(pendulum, tmp_path):
    step = written(pendulum(), tmp_path)
    first = step.act([0.1, math.nan], [0.2], [0.0])
    before = step.state.copy()
    assert step.act([0.1, math.nan], [math.nan], [0.0]).tolist() == first.tolist()
    assert np.array_equal(step.state, before)
    second = step.act([0.1, math.nan], [0.2], [0.0])
    assert second != first and not np.array_equal(step.state, before)


def test_the_file_says_what_goes_in_and_comes_out(rotors, tmp_path):
    told = written(rotors(), tmp_path).session.get_modelmeta().custom_metadata_map
    assert told["reference"] == "alpha_a, alpha_p" and told["period"] == "0.05 s"
    # begun, 2 inputs, 8 states with 64 covariances, two inputs more than whole periods of delay, 8 of the shift
    assert "units of u" not in told
    assert told["state"] == f"{1 + 2 + 8 + 64 + 2 * 2 + 8} numbers, zeros at the start"


def test_the_file_says_what_inputs_are_in_their_own_unit(pendulum, tmp_path):
    """Of 0 to 12 V, zero is 6 V."""
    volts = replace(Pendulum().signature, input_ends=((0, 12),))
    told = written(pendulum(signature=volts), tmp_path).session.get_modelmeta().custom_metadata_map
    assert told["units of u"].startswith("the plant's u is 6 + 6 times the controller's")
