"""The model in C is the model, and compiles without a word of its file in the code."""

import ctypes
import math
import re

import numpy as np
import pytest
import torch

from dynasindy.export import model_sources
from dynasindy.sindy import SindyModel
from dynasindy.systems import Signature
from dynasindy.systems.compiler import compile_library, compiler

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")
WORDS = ["1", "a", "a |a| b", "sign(b)", "exp(-(2 a)^2)", "sqrt(b - 0.3)", "max(0, a - -0.2)", "b /(1 + 3 cos(a)^2)"]


def compiled(sources, folder, result="dx"):
    for name, text in sources.files().items():
        (folder / name).write_text(text)
    call = getattr(
        ctypes.CDLL(str(compile_library([folder / f"{sources.name}.c"], folder / "m.so"))), f"{sources.name}_{result}"
    )

    def field(x, u, n):
        dx = (ctypes.c_double * n)()
        call((ctypes.c_double * len(x))(*x), (ctypes.c_double * max(1, len(u)))(*u), dx)
        return list(dx)

    return field


@needs_compiler
def test_it_computes_what_the_library_computes(tmp_path):
    model = SindyModel(Signature(("a", "b"), ("-", "-"), ("c",), (1.0, 1.0)), WORDS)
    table = np.random.default_rng(1).standard_normal((len(WORDS), 2))
    model.set_coefficients(torch.from_numpy(table))
    model.delay = 0.25
    sources = model_sources(model, "m1")
    field = compiled(sources, tmp_path)
    for x in np.random.default_rng(2).uniform(-1, 1, (20, 2)):
        expected = model.library(torch.from_numpy(x), torch.zeros(1)).numpy() @ table
        assert field(x, [0.0], 2) == pytest.approx(list(expected), rel=1e-12, abs=1e-14)
    assert "Inputs act 0.25 s after they are given" in " ".join(sources.header.split())
    for special in (-np.inf, np.nan):
        ours = np.array(field([0.1, special], [0.0], 2))
        with np.errstate(invalid="ignore"):
            theirs = model.library(torch.tensor([0.1, special]), torch.zeros(1)).numpy() @ table
        assert (np.isfinite(ours) == np.isfinite(theirs)).all()


@needs_compiler
def test_without_terms_or_inputs_it_compiles_too(tmp_path):
    model = SindyModel(Signature(("a",), ("-",), (), (1.0,)), ["a"])
    assert compiled(model_sources(model), tmp_path)([2.0], [], 1) == [0.0]


@needs_compiler
def test_hostile_names_are_comments_and_places_alone(pendulum_model, hostile, tmp_path):
    sources = model_sources(pendulum_model(hostile))
    assert compiled(sources, tmp_path)([0.0, 0.0], [0.5], 2) == [0.0, 4.0]
    bare = re.sub(r"/\*.*?\*/", "", sources.header, flags=re.S)
    assert "model_x_int = 0" in bare and "f()" not in bare


@needs_compiler
def test_a_difference_equation_is_what_comes_next(pendulum_model, tmp_path):
    """theta+ = theta + 0.05 Omega and Omega+ = Omega + 0.05 (8 u - 0.6 Omega - 2.5 tanh(3.7 theta) ...)."""
    sources = model_sources(pendulum_model(step=0.05))
    assert "x[k+1] = F(x[k], u[k])" in sources.header and "A step takes 0.05 s" in " ".join(sources.header.split())
    following = compiled(sources, tmp_path, "next")
    theta, omega, u = 0.4, -1.5, 0.3
    push = 8 * u - 0.6 * omega - 2.5 * math.tanh(3.7 * theta) - 6 * math.sin(theta) - 0.04 * omega * abs(omega)
    assert following([theta, omega], [u], 2) == pytest.approx([theta + 0.05 * omega, omega + 0.05 * push], rel=1e-12)
