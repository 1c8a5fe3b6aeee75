"""The model in CasADi, Python, SymPy and LaTeX is the model."""

import numpy as np
import pytest
import sympy
from controllers import HOSTILE, pendulum_model

from dynasindy.export.formats import casadi_source, latex_source
from dynasindy.sindy.pysindy_interchange import to_sympy

POINTS = np.random.default_rng(3).uniform(-1, 1, (10, 3))


def by_hand(x, u):
    """dx/dt of the pendulum of conftest."""
    theta, omega = x
    return [omega, 8 * u - 0.6 * omega - 2.5 * np.tanh(3.7 * theta) - 6 * np.sin(theta) - 0.04 * omega * abs(omega)]


def test_the_file_for_casadi_runs_and_computes_the_equations():
    pytest.importorskip("casadi", reason="CasADi is not installed: pip install -e '.[export]'")
    scope = {}
    exec(compile(casadi_source(pendulum_model(delay=0.1)), "model.py", "exec"), scope)
    function = scope["function"]()
    assert function.name() == "model" and scope["DELAY"] == 0.1 and scope["STATES"] == ("theta", "Omega")
    for *x, u in POINTS:
        np.testing.assert_allclose(np.array(function(x, u)).ravel(), by_hand(x, u), rtol=1e-12)


def test_names_of_a_file_are_strings_and_words_in_the_file_for_casadi():
    text = casadi_source(pendulum_model(HOSTILE))
    tree = compile(text, "model.py", "exec")
    assert "f" not in tree.co_names and ("int", "x y.z'-") in tree.co_consts and text.isascii()


def test_latex_shows_every_term_once():
    text = latex_source(pendulum_model(delay=0.1))
    assert text.startswith("% Inputs act 0.1 s after they are given.\n\\begin{align*}\n\\dot{\\theta} = & \\Omega")
    terms = (
        r" 8 u",
        r"0.6 \Omega",
        r"2.5 \tanh",
        r"3.7 \theta",
        r" 6 \sin{\left(\theta \right)}",
        r"0.04 \Omega \left|{\Omega}",
    )
    assert [text.count(term) for term in terms] == [1] * len(terms)


def test_a_difference_equation_is_what_comes_next_in_all_forms():
    model = pendulum_model(step=0.05)
    source = casadi_source(model)
    assert "STEP = 0.05" in source and "x[k+1] = F(x[k], u[k])" in source and '["next"]' in source
    theta, omega, u = (sympy.Symbol(name, real=True) for name in ("theta", "Omega", "u"))
    following = [float(each.subs({theta: 0.4, omega: -1.5, u: 0.3})) for each in to_sympy(model).values()]
    np.testing.assert_allclose(following, [0.4, -1.5] + 0.05 * np.array(by_hand([0.4, -1.5], 0.3)), rtol=1e-12)
    assert r"{\theta}[k+1]" in latex_source(model)
