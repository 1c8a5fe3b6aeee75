"""The policy as ONNX maps observations to actions as the network does."""

import sys

import numpy as np
import pytest
import torch

from dynasindy.control.files import network
from dynasindy.export.onnx_policy import columns, policy_onnx


def test_onnxruntime_acts_as_the_policy(pendulum, tmp_path):
    onnx = pytest.importorskip("onnx", reason="onnx is not installed: pip install -e '.[export]'")
    runtime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: pip install -e '.[export]'")
    controller = pendulum()
    policy_onnx(controller, tmp_path / "policy.onnx")
    onnx.checker.check_model(str(tmp_path / "policy.onnx"), full_check=True)
    graph = onnx.load(str(tmp_path / "policy.onnx"))
    assert (graph.ir_version, [each.version for each in graph.opset_import]) == (8, [17])  # of 2022
    session = runtime.InferenceSession(str(tmp_path / "policy.onnx"), providers=["CPUExecutionProvider"])
    seen = torch.from_numpy(np.random.default_rng(0).standard_normal((50, 4)).astype(np.float32))
    (found,) = session.run(["action"], {"observation": seen.numpy()})
    expected = network(controller)(seen.clone()).numpy()
    assert expected.std() > 0.05
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    told = session.get_modelmeta().custom_metadata_map
    assert told["action"] == "u" and told["observation"].startswith("theta / 1.5, Omega / 3.0, (theta wanted - theta)")


def test_the_columns_of_the_observation_are_told(pendulum):
    assert columns(pendulum())["observation"] == [
        "theta / 1.5",
        "Omega / 3.0",
        "(theta wanted - theta) / 0.7",
        "rate of theta wanted / 1.4",
    ]


def test_without_onnx_one_line_says_what_to_install(pendulum, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(ModuleNotFoundError, match=r"install it by pip install 'dynasindy\[export\]'"):
        policy_onnx(pendulum(), tmp_path / "p.onnx")
    assert not list(tmp_path.iterdir())
