"""Generated derivatives are those of closed forms and of autograd; what is zero is not computed."""

import numpy as np
import pytest
import torch

from dynasindy.sindy import functions
from dynasindy.sindy.functions import Function, register_function
from dynasindy.sindy.library import CONSTANT, Library, of, parse, variable
from dynasindy.sindy.named_libraries import build_library
from dynasindy.sindy.sensitivity import Slopes
from dynasindy.systems import Tras
from dynasindy.systems.base import Signature

SIGNATURE = Signature(("a", "b"), ("-", "-"), ("u",), (1.0, 1.0))
OWN = tuple(functions._REGISTRY)
SMALLEST = 1e-3


def sech2(z: np.ndarray) -> np.ndarray:
    return 1 / np.cosh(z) ** 2


SCALED = {
    "id": (lambda z: z, lambda z: 1 + 0 * z),
    "sin": (np.sin, np.cos),
    "cos": (np.cos, lambda z: -np.sin(z)),
    "abs": (np.abs, np.sign),
    "sign": (np.sign, lambda z: 0 * z),
    "exp": (np.exp, np.exp),
    "tanh": (np.tanh, sech2),
    "sqrt": (lambda z: np.sqrt(np.maximum(z, SMALLEST)), lambda z: (z > 0) * 0.5 * np.abs(z) ** -0.5),
    "bell": (lambda z: np.exp(-z * z), lambda z: -2 * z * np.exp(-z * z)),
}
"""Functions of a scaled variable and their derivatives."""
PARAMETRIC = {
    "root": (
        lambda z, p: np.sqrt(np.maximum(z - p, SMALLEST)),
        lambda z, p: (z > p) * 0.5 * np.abs(z - p) ** -0.5,
        lambda z, p: (z > p) * -0.5 * np.abs(z - p) ** -0.5,
    ),
    "hinge": (lambda z, p: np.maximum(z - p, 0), lambda z, p: 1.0 * (z > p), lambda z, p: -1.0 * (z > p)),
    "per_cos2": (
        lambda z, p: 1 / (1 + p * np.cos(z) ** 2),
        lambda z, p: p * np.sin(2 * z) / (1 + p * np.cos(z) ** 2) ** 2,
        lambda z, p: -(np.cos(z) ** 2) / (1 + p * np.cos(z) ** 2) ** 2,
    ),
}
"""Functions of a variable and a number, and their derivatives by either."""

TURNED = {
    f"{name}_{word}": (name, sign) for name in ("sin", "cos", "per_cos2") for word, sign in (("sum", 1), ("gap", -1))
}
"""Functions of the sum or the difference of two variables: which function, and the sign of the second variable."""


def points(n: int = 9, n_x: int = 2, n_u: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(3)
    return tuple(3 * torch.rand(n, k, generator=generator, dtype=torch.float64) - 1.2 for k in (n_x, n_u))


def full(slopes: Slopes, library: Library, x: torch.Tensor, u: torch.Tensor, n_shapes: int = 0) -> list[torch.Tensor]:
    """Functions, derivatives by the states and by the numbers, the zeros filled in."""
    theta, by_state, by_shape = slopes(x, u)
    tables = [torch.zeros(len(x), len(library), n, dtype=x.dtype) for n in (library.signature.n_x, n_shapes)]
    for table, places, values in zip(tables, (slopes.by_state, slopes.by_shape), (by_state, by_shape)):
        assert values.shape == (len(x), len(places))
        for (k, j), value in zip(places, values.unbind(-1)):
            table[:, k, j] = value
    return [theta, *tables]


def test_every_function_of_the_package_has_its_closed_form_here():
    assert {*SCALED, *PARAMETRIC, *TURNED, "ahead", "slack"} == {name for name in OWN if not name.endswith("_test")}


@pytest.mark.parametrize("scale", [1.0, -2.5])
@pytest.mark.parametrize("name", SCALED)
def test_slopes_of_functions_of_a_scaled_variable(name, scale):
    value, slope = SCALED[name]
    library = Library(SIGNATURE, [of(name, "b", frequency=scale, fitted=True)])
    x, u = points()
    theta, by_state, by_shape = full(Slopes(library, library.shapes), library, x, u, 1)
    b = x[:, 1].numpy()
    np.testing.assert_allclose(theta[:, 0], value(scale * b), rtol=1e-12)
    np.testing.assert_allclose(by_state[:, 0, 1], scale * slope(scale * b), rtol=1e-10, atol=1e-12)
    assert not bool(by_state[:, 0, 0].any())
    for found in (by_shape, library.by_shapes(x, u, library.shapes)):
        np.testing.assert_allclose(found[:, 0, 0], b * slope(scale * b), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("number", [0.3, 1.7])
@pytest.mark.parametrize("name", PARAMETRIC)
def test_slopes_of_functions_with_a_number_of_their_own(name, number):
    value, slope, by_number = PARAMETRIC[name]
    library = Library(SIGNATURE, [of(name, "b", frequency=number, fitted=True)])
    x, u = points()
    theta, by_state, by_shape = full(Slopes(library, library.shapes), library, x, u, 1)
    b = x[:, 1].numpy()
    np.testing.assert_allclose(theta[:, 0], value(b, number), rtol=1e-12)
    np.testing.assert_allclose(by_state[:, 0, 1], slope(b, number), rtol=1e-10, atol=1e-12)
    for found in (by_shape, library.by_shapes(x, u, library.shapes)):
        np.testing.assert_allclose(found[:, 0, 0], by_number(b, number), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("name", TURNED)
def test_slopes_of_functions_of_the_sum_and_the_difference_of_two_variables(name):
    plain, sign = TURNED[name]
    number = (0.3,) if plain in PARAMETRIC else ()
    value, slope, *by_number = (PARAMETRIC if number else SCALED)[plain]
    library = Library(SIGNATURE, [of(name, "a", "b", frequency=0.3, fitted=True) if number else of(name, "a", "b")])
    x, u = points()
    theta, by_state, by_shape = full(Slopes(library, library.shapes), library, x, u, len(number))
    angle = x[:, 0].numpy() + sign * x[:, 1].numpy()
    np.testing.assert_allclose(theta[:, 0], value(angle, *number), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(by_state[:, 0, 0], slope(angle, *number), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(by_state[:, 0, 1], sign * slope(angle, *number), rtol=1e-10, atol=1e-12)
    for closed in by_number:
        np.testing.assert_allclose(by_shape[:, 0, 0], closed(angle, *number), rtol=1e-10, atol=1e-12)


def test_slopes_of_products_and_powers_by_states_and_by_the_numbers_inside():
    words = ["u^2 tanh(~2 a)^3 b", "a^2 per_cos2(~3 b)^2", "tanh(~2 a)", "tanh(2 a)", "b^4", "u", "1"]
    library = Library(SIGNATURE, map(parse, words))
    x, u = points()
    (a, b), v = x.numpy().T, u[:, 0].numpy()
    t, q = np.tanh(2 * a), 1 / (1 + 3 * np.cos(b) ** 2)
    theta, by_state, by_shape = full(slopes := Slopes(library, library.shapes), library, x, u, 2)
    expected = [v**2 * t**3 * b, a**2 * q**2, t, t, b**4, v, 1 + 0 * v]
    np.testing.assert_allclose(theta.numpy().T, expected, rtol=1e-12)
    none, grow = 0 * a, 2 * sech2(2 * a)
    by_a = [3 * v**2 * t**2 * grow * b, 2 * a * q**2, grow, grow, none, none, none]
    by_b = [v**2 * t**3, a**2 * 2 * q * 3 * np.sin(2 * b) * q**2, none, none, 4 * b**3, none, none]
    np.testing.assert_allclose(by_state[:, :, 0].numpy().T, by_a, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(by_state[:, :, 1].numpy().T, by_b, rtol=1e-10, atol=1e-12)
    width = [3 * v**2 * t**2 * a * sech2(2 * a) * b, none, a * sech2(2 * a), none, none, none, none]
    inertia = [none, -(a**2) * 2 * q**3 * np.cos(b) ** 2, none, none, none, none, none]
    for found in (by_shape, library.by_shapes(x, u, library.shapes)):
        np.testing.assert_allclose(found[:, :, 0].numpy().T, width, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(found[:, :, 1].numpy().T, inertia, rtol=1e-10, atol=1e-12)
    # Only what is not zero is computed.
    assert slopes.by_state == [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (3, 0), (4, 1)]
    assert slopes.by_shape == [(0, 0), (1, 1), (2, 0)]


def test_negative_powers_and_functions_of_two_variables(monkeypatch):
    monkeypatch.setattr(functions, "_REGISTRY", dict(functions._REGISTRY))
    register_function("angle_of", torch.atan2)
    functions._REGISTRY["arc"] = Function("arc", lambda z, p: torch.atan(z / p), "arc({0})", "", parametric=True)
    library = Library(SIGNATURE, [variable("b", -2) * variable("a"), of("angle_of", "a", "b"), of("arc", "a")])
    x, u = points()
    a, b = x.numpy().T
    _, by_state, _ = full(Slopes(library), library, x, u)
    np.testing.assert_allclose(by_state[:, 0].numpy().T, [b**-2, -2 * a * b**-3], rtol=1e-10)
    np.testing.assert_allclose(by_state[:, 1].numpy().T, [b / (a**2 + b**2), -a / (a**2 + b**2)], rtol=1e-10)
    np.testing.assert_allclose(by_state[:, 2].numpy().T, [1 / (a**2 + 1), 0 * a], rtol=1e-10)


def test_functions_of_the_inputs_alone_have_no_slopes():
    library = Library(SIGNATURE, [CONSTANT, variable("u", 2), of("tanh", "u", frequency=2.0)])
    slopes = Slopes(library)
    theta, by_state, by_shape = slopes(*points(4))
    assert slopes.by_state == slopes.by_shape == [] and by_state.shape == by_shape.shape == (4, 0)
    assert torch.equal(theta[:, 0], torch.ones(4).double())


@pytest.mark.parametrize("name", ["paper_table", "paper_equation", "rotor", "rotor_reaction", "polynomial", "fourier"])
def test_slopes_of_libraries_are_those_of_autograd(name):
    library = build_library(name, Tras().signature)
    x, u = points(4, 6, 2)
    theta, by_state, _ = full(slopes := Slopes(library), library, x, u)
    expected = torch.func.vmap(torch.func.jacrev(library), (0, 0))(x, u)
    assert torch.allclose(theta, library(x, u), rtol=1e-12)
    assert torch.allclose(by_state, expected, rtol=1e-10, atol=1e-12)
    reads = [(k, i) for k, f in enumerate(library.features) for i, n in enumerate(Tras().signature.state_names)
             if n in f.variables]  # fmt: skip
    assert slopes.by_state == reads


def test_slopes_of_a_difference_are_one_and_minus_one():
    library = Library(Signature(("a", "b"), ("-", "-"), (), (1.0, 1.0)), [of("ahead", "a", "b")])
    x = torch.tensor([[2.0, 0.5], [-1.0, 3.0]], dtype=torch.float64)
    theta, by_state, _ = full(Slopes(library, ()), library, x, torch.zeros(2, 0))
    assert theta[:, 0].tolist() == [1.5, -4.0] and by_state[:, 0].tolist() == [[1.0, -1.0]] * 2


def test_slopes_of_slack_are_those_of_a_difference_beyond_a_number():
    library = Library(
        Signature(("a", "b"), ("-", "-"), (), (1.0, 1.0)), [of("slack", "a", "b", frequency=0.5, fitted=True)]
    )
    x = torch.tensor([[2.0, 1.0], [0.3, 0.0], [-2.0, 0.0]], dtype=torch.float64)
    theta, by_state, by_shape = full(Slopes(library, library.shapes), library, x, torch.zeros(3, 0), 1)
    assert theta[:, 0].tolist() == [0.5, 0.0, -1.5]
    assert by_state[:, 0].tolist() == [[1.0, -1.0], [0.0, 0.0], [1.0, -1.0]]
    assert by_shape[:, 0, 0].tolist() == [-1.0, 0.0, 1.0]
