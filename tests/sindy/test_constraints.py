"""Prior knowledge becomes a mask and given numbers, each where its name says."""

import pytest
import torch

from dynasindy.sindy import SindyModel
from dynasindy.sindy.constraints import Constraints
from dynasindy.sindy.library import CONSTANT, Library, of, variable
from dynasindy.systems.base import Signature

SIGNATURE = Signature(("a", "b"), ("rad", "rad/s"), ("u",), (1.0, 1.0))
FEATURES = [CONSTANT, variable("a"), variable("b"), variable("u"), of("sin", "a")]


def build(library: Library | None = None, known=None, allowed=None, fixed=None) -> Constraints:
    return Constraints.build(library or Library(SIGNATURE, FEATURES), known or {}, allowed or {}, fixed or {})


def test_without_knowledge_all_is_free():
    constraints = build()
    assert constraints.free.shape == constraints.offset.shape == (5, 2)
    assert bool(constraints.free.all()) and not bool(constraints.offset.any())
    assert constraints.offset.dtype == torch.float64


def test_a_known_rate_is_one_function_and_nothing_else():
    constraints = build(known={"a": "b"}, fixed={"a": {"u": 3.0}})
    assert constraints.free[:, 0].tolist() == [False] * 5 and bool(constraints.free[:, 1].all())
    assert constraints.offset.tolist() == [[0, 0], [0, 0], [1, 0], [0, 0], [0, 0]]


def test_functions_that_may_not_occur_are_masked_in_that_equation_only():
    constraints = build(allowed={"b": ["u", "sin(a)"]})
    assert constraints.free.mT.tolist() == [[True] * 5, [False, False, False, True, True]]


def test_the_library_s_own_mask_holds_until_another_is_given():
    library = Library(SIGNATURE, FEATURES, {"a": [variable("b")], "b": [CONSTANT]})
    free = build(library, allowed={"a": ["a"]}).free.mT
    assert free.tolist() == [[False, True, False, False, False], [True, False, False, False, False]]


def test_a_given_coefficient_is_no_longer_estimated():
    constraints = build(allowed={"b": ["b", "u"]}, fixed={"b": {"u": 2, "sin(a)": -9.81}})
    assert constraints.free[:, 1].tolist() == [False, False, True, False, False]
    assert constraints.offset[:, 1].tolist() == [0.0, 0.0, 0.0, 2.0, -9.81]


@pytest.mark.parametrize(
    ("knowledge", "said"),
    [
        ({"known": {"c": "b"}}, "world_model.known names c, which is no state; the states are"),
        ({"known": {"a": "c"}}, "world_model.known.a: function 'c' is not among the 5 candidate functions, such as "),
        ({"allowed": {"b": ["cos(a)"]}}, "world_model.allowed.b: function 'cos(a)' is not among the "),
        ({"allowed": {"u": ["a"]}}, "world_model.allowed names u, which is no state; the states are"),
        ({"fixed": {"b": {"b^2": 1.0}}}, "world_model.fixed.b: function 'b^2' is not among the "),
        ({"fixed": {"c": {"b": 1.0}}}, "world_model.fixed names c, which is no state; the states are"),
    ],
)
def test_names_that_do_not_exist_are_refused_in_one_line(knowledge, said):
    with pytest.raises(ValueError, match=r".") as error:
        build(**knowledge)
    assert said in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("initial", "said"),
    [
        (
            {"b": {"a": 1.0, "sinh(a)": 0.1}},
            r"^plant\.initial\.b: function 'sinh\(a\)' is not among the 5 ",
        ),
        ({"c": {"a": 1.0}}, r"^plant\.initial names c, which is no state; the states are a, b: correct the name$"),
    ],
)
def test_a_first_guess_that_the_library_lacks_says_where_it_stands(initial, said):
    with pytest.raises(ValueError, match=said):
        SindyModel(SIGNATURE, Library(SIGNATURE, FEATURES), initial=initial)
