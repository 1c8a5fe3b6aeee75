"""What is computed with values of a graph is what NumPy computes with numbers."""

import numpy as np
import pytest

from dynasindy.export.onnx_graph import Graph, functions

onnx = pytest.importorskip("onnx", reason="onnx is not installed: pip install -e '.[export]'")
runtime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: pip install -e '.[export]'")
A = np.array([[0.5, -1.5], [2.0, 0.25]])
X = np.array([0.3, -0.7])


def result(tmp_path, formula, shape):
    """Return what a formula of a matrix and a vector is in the graph."""
    graph = Graph()
    a, x = graph.given("a", [2, 2]), graph.given("x", [2])
    graph.result(formula(graph, a, x), "y", shape)
    graph.save(tmp_path / "g.onnx", "formula", {"about": "nothing"})
    onnx.checker.check_model(str(tmp_path / "g.onnx"), full_check=True)
    session = runtime.InferenceSession(str(tmp_path / "g.onnx"), providers=["CPUExecutionProvider"])
    assert session.get_modelmeta().custom_metadata_map == {"about": "nothing"}
    (found,) = session.run(["y"], {"a": A, "x": X})
    return found


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        (lambda g, a, x: 2.0 - x / 4.0 + x * x, 2.0 - X / 4 + X * X),
        (lambda g, a, x: 1.0 / (x - 3.0) - -x, 1 / (X - 3) + X),
        (lambda g, a, x: (a.transposed @ x.reshape(2, 1)).reshape(2), A.T @ X),
        (lambda g, a, x: np.eye(2)[1] - a @ x, np.eye(2)[1] - A @ X),
        (lambda g, a, x: a[1] * x[0], A[1] * X[0]),
        (lambda g, a, x: a[1:2].reshape(2) + x.total(), A[1] + X.sum()),
        (lambda g, a, x: g.stack([x, a[0]], 1)[1], np.array([X[1], A[0, 1]])),
        (lambda g, a, x: x.where(g.put("Less", x, 0.0), 9.0), np.array([9.0, -0.7])),
        (lambda g, a, x: g.constant([1.0, 2.0]).where((x / np.array([0.0, 1.0])).finite(), 5.0), np.array([5.0, 2.0])),
    ],
)
def test_operators_are_those_of_arrays(tmp_path, formula, expected):
    np.testing.assert_allclose(result(tmp_path, formula, expected.shape), expected, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        *[(name, getattr(np, name)) for name in ("sin", "cos", "exp", "tanh", "fabs", "sign", "square")],
        ("sqrt", lambda x: np.sqrt(np.abs(x))),
    ],
)
def test_functions_are_those_of_formulas(tmp_path, name, expected):
    def formula(graph, a, x):
        calls = functions(graph)
        return calls[name](calls["fabs"](x) if name == "sqrt" else x)

    np.testing.assert_allclose(result(tmp_path, formula, (2,)), expected(X), rtol=1e-14)


def test_the_larger_of_two_is_that(tmp_path):
    found = result(tmp_path, lambda graph, a, x: functions(graph)["larger"](x, 0.1), (2,))
    assert found.tolist() == [0.3, 0.1]


def test_the_same_numbers_are_kept_once():
    graph = Graph()
    assert graph.constant([1.0, 2.0]).name == graph.constant([1.0, 2.0]).name
    names = {graph.constant(v, t).name for v, t in (([1.0, 2.0], np.float64), ([[1.0, 2.0]], np.float64))}
    assert len(names | {graph.constant([1.0, 2.0], np.float32).name}) == 3
