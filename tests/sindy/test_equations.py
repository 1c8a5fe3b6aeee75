"""Tables of Xi say the same numbers as Xi, in every form."""

import csv
import io
import math
import re

import pytest
import torch

from dynasindy.identification.identify import _coefficient_tables
from dynasindy.sindy.library import CONSTANT, Library, equations, of, variable
from dynasindy.sindy.model import SindyModel
from dynasindy.systems import Xi
from dynasindy.systems.base import Signature

SIGNATURE = Signature(("alpha_p", "b"), ("rad", "m"), ("u",), (1.0, 1.0))
LIBRARY = Library(SIGNATURE, [CONSTANT, variable("b"), variable("u", 2) * of("sin", "alpha_p"), of("cos", "alpha_p")])
COEFFICIENTS = torch.tensor([[-0.5, 0], [1, 0], [0, 0], [-1, 1234567.8]], dtype=torch.float64)


def tables(library: Library, xi: torch.Tensor) -> dict[str, str]:
    model = SindyModel(library.signature, library)
    model.library, model.coefficients = library, xi
    return _coefficient_tables(model)


def published() -> SindyModel:
    """The table of the paper, found from exact derivatives."""
    generator = torch.Generator().manual_seed(1)
    x = (2 * torch.rand(2000, 6, generator=generator, dtype=torch.float64) - 1) * torch.tensor([1, 1, 1, 1, 3e3, 2e3])
    u = 2 * torch.rand(2000, 2, generator=generator, dtype=torch.float64) - 1
    model = SindyModel(Xi().signature)
    model.fit_derivatives(x, u, Xi()(x, u))
    return model


def test_equations_write_signs_ones_and_empty_rows_as_a_reader_would():
    assert equations(LIBRARY, COEFFICIENTS) == ["alpha_p' = -0.5 + b - cos(alpha_p)", "b' = 1.235e+06 cos(alpha_p)"]
    assert equations(LIBRARY, COEFFICIENTS, digits=8)[1] == "b' = 1234567.8 cos(alpha_p)"
    assert equations(LIBRARY, torch.zeros(4, 2)) == ["alpha_p' = 0", "b' = 0"]
    assert equations(LIBRARY, torch.tensor([[0.0, 1.0], [-1.0, 0], [2e-5, 0], [0, 0]])) == [
        "alpha_p' = -b + 2e-05 u^2 sin(alpha_p)",
        "b' = 1",
    ]


@pytest.mark.parametrize(
    ("values", "written"),
    [
        ((0, 2.0, -3.0, 0, 0), "(2 b - 3 u^2) /(1 + 3 cos(alpha_p)^2)"),
        ((0.5, 2.0, 0, -1.0, 0), "0.5 + (2 b - 1) /(1 + 3 cos(alpha_p)^2)"),
        ((0, -2.0, 0, 0, 0), "-2 b /(1 + 3 cos(alpha_p)^2)"),
        ((1.0, 2.0, 1.0, 0, -7.0), "1 + (2 b + u^2) /(1 + 3 cos(alpha_p)^2) - 7 b /(1 + 2 cos(alpha_p)^2)"),
    ],
)
def test_what_is_divided_by_the_same_is_written_over_it_once(values, written):
    by, other = of("per_cos2", "alpha_p", frequency=3.0, fitted=True), of("per_cos2", "alpha_p", frequency=2.0)
    b = variable("b")
    library = Library(SIGNATURE, [CONSTANT, b * by, variable("u", 2) * by, by, other * b])
    assert equations(library, torch.tensor([values, (0,) * 5]).mT) == [f"alpha_p' = {written}", "b' = 0"]


@pytest.mark.parametrize(("k", "inside"), [(-0.25, -5.2), (3.0, -4.0), (3.0, -5.0), (3.0, 5.0), (3.0, -1.0)])
def test_what_nearly_cancels_across_a_quotient_is_written_as_one_that_has_the_same_values(k, inside):
    f, by = of("sin", "alpha_p"), of("per_cos2", "alpha_p", frequency=k)
    library = Library(SIGNATURE, [f, f * by, variable("u") * by])
    text, _ = equations(library, torch.tensor([[5.0, inside, 1.0], [0, 0, 0]]).mT)
    plain = re.sub(r"(?<=[\w)]) (?=[a-z(])", "*", text.partition(" = ")[2].replace("^", "**"))
    for angle in (0.3, 1.2):
        found = eval(plain, {"sin": math.sin, "cos": math.cos, "alpha_p": angle, "u": 2.0})
        assert found == pytest.approx(
            5 * math.sin(angle) + (inside * math.sin(angle) + 2) / (1 + k * math.cos(angle) ** 2)
        )
    assert (" sin(alpha_p) cos(alpha_p)^2" in text) == (abs(5 + inside) < 0.5 * min(5, abs(inside)))


def test_csv_holds_every_digit_and_the_units():
    library, xi = LIBRARY, COEFFICIENTS / 3
    header, *rows = csv.reader(io.StringIO(tables(library, xi)["csv"]))
    assert header == ["function", "d(alpha_p)/dt [rad/s]", "d(b)/dt [m/s]"]
    assert [row[0] for row in rows] == list(library.names)
    assert torch.equal(torch.tensor([[float(v) for v in row[1:]] for row in rows], dtype=torch.float64), xi)


def test_all_forms_hold_the_19_published_numbers():
    model = published()
    text, numbers = (_coefficient_tables(model)[key] for key in ("txt", "csv"))
    rows = {line[:24].strip(): line[24:].split() for line in text.splitlines()[1:]}
    assert len(rows) == 27 and sum(v != "0" for row in rows.values() for v in row) == 19
    assert rows["Omega_a^2 sin(alpha_p)"][3] == "-16.355" and rows["1"][2:] == ["0", "0.5961", "262.7", "-8.54"]
    numbers = [float(v) for row in list(csv.reader(io.StringIO(numbers)))[1:] for v in row[1:]]
    assert sorted(n for n in numbers if n)[-2:] == pytest.approx([6.1e3, 3.7e4])


def test_a_difference_equation_is_written_as_what_a_state_is_next():
    """p[k+1] = p + 0.5 (2 v - 0.2 u) and v[k+1] = v + 0.5 (-2 v + 3 p^2), whose own v is gone."""
    signature = Signature(("p", "v"), ("m", "m/s"), ("u",), (1.0, 1.0))
    p, v = variable("p"), variable("v")
    library = Library(signature, [v, variable("u"), p * p], step=0.5)
    xi = torch.tensor([[2.0, -2.0 + 1e-13], [-0.2, 0.0], [0.0, 3.0]], dtype=torch.float64)
    assert equations(library, xi) == ["p[k+1] = p + v - 0.1 u", "v[k+1] = 1.5 p^2"]
    text = tables(library, xi)["txt"].splitlines()
    assert text[0].split() == ["function", "p[k+1]", "v[k+1]"] and [line.split()[0] for line in text[1:]] == [
        "p", "v", "u", "p^2",
    ]  # fmt: skip
    rows = list(csv.reader(io.StringIO(tables(library, xi)["csv"])))
    assert rows[0] == ["function", "p[k+1] [m]", "v[k+1] [m/s]"] and ["p", "1.0", "0.0"] in rows
