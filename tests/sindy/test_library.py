"""Features, libraries of them, and prior knowledge of their coefficients."""

import math
import pickle

import pytest
import torch

from dynasindy.sindy.library import CONSTANT, Constraints, Feature, Library, of, parse, variable
from dynasindy.sindy.named_libraries import build_library, polynomial
from dynasindy.systems.base import Signature

SIGNATURE = Signature(("a", "b"), ("rad", "rad/s"), ("u",), (1.0, 1.0))


def _points(n: int = 5) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return tuple(2 * torch.rand(n, k, generator=generator, dtype=torch.float64) - 1 for k in (6, 2))


def test_powers_products_and_functions_are_those_that_they_say_also_of_a_copy():
    a, u = variable("a"), variable("u")
    features = [CONSTANT, a, variable("a", 3), variable("b", -1), variable("a", 2) * u]
    features += [of("sin", "b", power=3, frequency=2.0) * a, of("ahead", "u", "a"), of("sin", "b", frequency=2.0)]
    library = Library(SIGNATURE, features)
    x, v = (part[:, :k] for part, k in zip(_points(7), (2, 1), strict=True))
    p, q, r = x[:, 0], x[:, 1], v[:, 0]
    sine = torch.sin(2.0 * q)
    wanted = [torch.ones(7), p, p * p * p, 1 / q, p * p * r, sine * sine * sine * p, r - p, sine]
    wanted = torch.stack([column.double() for column in wanted], -1)
    for found in (library, library, pickle.loads(pickle.dumps(library)), library.with_step(0.1)):
        torch.testing.assert_close(found(x, v), wanted, rtol=1e-13, atol=1e-14)
    torch.testing.assert_close(library.subset([5, 2])(x, v), wanted[:, [5, 2]], rtol=1e-13, atol=1e-14)
    assert library(x.float(), v).dtype == torch.float32


def test_names_that_do_not_exist_are_refused():
    with pytest.raises(ValueError, match="beta"):
        Library(SIGNATURE, [variable("beta")])
    with pytest.raises(ValueError, match="papertable"):
        build_library("papertable", SIGNATURE)
    with pytest.raises(ValueError, match="a\\^9"):
        polynomial(SIGNATURE).index("a^9")
    with pytest.raises(ValueError, match="empty"):
        Library(SIGNATURE, [])
    with pytest.raises(ValueError, match="'c'"):
        Library(SIGNATURE, [variable("a")], allowed={"c": [variable("a")]})


@pytest.mark.parametrize(
    "text",
    [
        "sin(a + b)",
        "tanh(a + b)^2",
        "|a - b|",
        "exp(-(a - b)^2)",
        "w cos(a - b)^2",
        "u /(1 - 0.3 cos(a - b)^2)",
        "/(1 + 0.5 cos(a + b)^2)",
    ],
)
def test_functions_of_two_angles_are_read_as_they_are_written(text):
    feature = parse(text)
    assert parse(text.replace("(a - b", "(a-b").replace("(a + b", "(a+b")) == feature
    assert feature.name() == text and Feature.from_list(feature.to_list()) == feature
    assert {"a", "b"} <= feature.variables


WRITTEN = {
    "w^2 /(1 + 3 cos(a)^2)": variable("w", 2) * of("per_cos2", "a", frequency=3.0),
    "w /(1 - 0.25 cos(a)^2)": variable("w") * of("per_cos2", "a", frequency=-0.25),
    "/(1 + 0.25 cos(a)^2)^2": of("per_cos2", "a", frequency=0.25, power=2),
    "max(0, w - 0.5)": of("hinge", "w", frequency=0.5),
    "max(0, w + 1e-05)^3": of("hinge", "w", frequency=-1e-5, power=3),
    "sqrt(h - 0.2)": of("root", "h", frequency=0.2),
    "sqrt(h + 0.2) w": of("root", "h", frequency=-0.2) * variable("w"),
    "sqrt(2 h)": of("sqrt", "h", frequency=2.0),
    "exp(-(4 a)^2)": of("bell", "a", frequency=4.0),
    "exp(-(a)^2)^2": of("bell", "a", power=2),
    "|2 w|": of("abs", "w", frequency=2.0),
    "tanh(-20 w)": of("tanh", "w", frequency=-20.0),
    "(w - h) a": of("ahead", "w", "h") * variable("a"),
    "(w - h)^2": of("ahead", "w", "h", power=2),
    "slack(w, h; 0.25)": of("slack", "w", "h", frequency=0.25),
}


@pytest.mark.parametrize("text", WRITTEN)
def test_what_is_written_is_read_again(text):
    assert WRITTEN[text].name() == text
    assert parse(text) == WRITTEN[text]


WORDS = (
    "w /(1 - 0.3 cos(a)^2)",
    "max(0, w - 0.5)",
    "sqrt(w + 0.5)",
    "exp(-(4 a)^2)",
    "sqrt(2 a)^3",
    "slack(w, a; 0.4)",
    "slack(a, w; 0.4)",
)


def test_the_values_are_those_that_the_words_say():
    library = Library(Signature(("a", "w"), ("-", "-"), (), (1.0, 1.0)), map(parse, WORDS))
    a, w = 0.7, 1.3
    found = library(torch.tensor([[a, w]], dtype=torch.float64), torch.zeros(1, 0))[0].tolist()
    assert found == pytest.approx(
        [
            w / (1 - 0.3 * math.cos(a) ** 2),
            max(0.0, w - 0.5),
            math.sqrt(w + 0.5),
            math.exp(-((4 * a) ** 2)),
            math.sqrt(2 * a) ** 3,
            w - a - 0.4,
            a - w + 0.4,
        ]
    )


@pytest.mark.parametrize("name", ["tanh", "per_cos2", "hinge", "root", "bell"])
def test_a_first_guess_is_a_number_that_is_fitted(name):
    (factor,) = parse(f"{name}(~2.5 a)").factors
    assert factor == of(name, "a", frequency=2.5, fitted=True).factors[0]
    assert (factor.frequency, factor.fitted) == (2.5, 2.5)
    assert parse(f"{name}(2.5 a)").factors[0].fitted == 0
    # No number goes farther than a factor of 30 from its first guess, nor through zero.
    assert [factor.with_number(n).frequency for n in (1e3, 3.0, -1.0)] == [75.0, 3.0, 2.5 / 30]
    negative = parse(f"{name}(~-2 a)").factors[0]
    assert [negative.with_number(n).frequency for n in (-1e3, 1.0)] == [-60.0, -2 / 30]


FEATURES = [CONSTANT, variable("a"), variable("b"), variable("u"), of("sin", "a")]


def build(library: Library | None = None, known=None, allowed=None, fixed=None) -> Constraints:
    return Constraints.build(library or Library(SIGNATURE, FEATURES), known or {}, allowed or {}, fixed or {})


def test_a_known_rate_is_one_function_and_nothing_else():
    constraints = build(known={"a": "b"}, fixed={"a": {"u": 3.0}})
    assert constraints.free[:, 0].tolist() == [False] * 5 and bool(constraints.free[:, 1].all())
    assert constraints.offset.tolist() == [[0, 0], [0, 0], [1, 0], [0, 0], [0, 0]]


def test_the_library_s_own_mask_holds_until_another_is_given():
    library = Library(SIGNATURE, FEATURES, {"a": [variable("b")], "b": [CONSTANT]})
    free = build(library, allowed={"a": ["a"]}).free.mT
    assert free.tolist() == [[False, True, False, False, False], [True, False, False, False, False]]
