"""Features print, multiply and survive a file."""

import pytest
import torch

from dynasindy.world_models.features import CONSTANT, Feature, latex_name, of, register_function, variable


def test_names_are_those_a_reader_would_write():
    square = variable("Omega_a") * variable("Omega_a") * of("sin", "alpha_p")
    assert square.name() == "Omega_a^2 sin(alpha_p)"
    assert (variable("w") * of("abs", "w")).name() == "w |w|"
    assert of("cos", "a", frequency=2.0).name() == "cos(2 a)"
    assert CONSTANT.name() == "1"


def test_latex_is_that_of_the_paper():
    square = variable("x_3", 2) * of("sin", "x_2")
    assert square.latex() == r"x_{3}^{2} \, \sin x_{2}"
    assert of("cos", "alpha_p", power=2).latex() == r"\cos^{2} \alpha_{p}"
    assert latex_name("x12") == "x_{12}"
    assert [latex_name(name) for name in ("v", "speed_a", "rate")] == ["v", r"\mathrm{speed}_{a}", r"\mathrm{rate}"]


def test_products_are_equal_whatever_their_order():
    a, b = variable("a"), of("sin", "b")
    assert (a * b).key == (b * a).key
    assert (a * a).factors[0].power == 2


def test_a_feature_survives_plain_lists():
    feature = variable("a", 2) * of("cos", "b", power=3, frequency=0.5)
    assert Feature.from_list(feature.to_list()) == feature


def test_unknown_functions_and_bad_names_are_refused():
    with pytest.raises(ValueError, match="'sinh' is not known"):
        of("sinh", "a")
    with pytest.raises(ValueError, match="identifier"):
        register_function("a b", torch.sin)


def test_a_user_function_becomes_a_feature():
    register_function("softplus_test", torch.nn.functional.softplus)
    assert of("softplus_test", "a").name() == "softplus_test(a)"
