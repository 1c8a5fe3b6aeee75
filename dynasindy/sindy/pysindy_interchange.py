"""Sparse models to and from PySINDy, and to sympy."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import torch

from dynasindy.sindy.codegen import right_sides
from dynasindy.sindy.library import Feature, Library, parse
from dynasindy.sindy.model import SindyModel
from dynasindy.systems.base import Signature


def to_pysindy(model: SindyModel) -> Any:
    """Return a fitted `pysindy.SINDy` with the same functions and coefficients.

    PySINDy's own `predict`, `simulate` and `print` then work on it. Each function is a custom one of all states and
    inputs, so that libraries of any form fit into PySINDy's.

    Raises:
        ValueError: the model is a difference equation.
    """
    if model.step is not None:
        raise ValueError(
            "to_pysindy got a difference equation; allowed are differential equations: use to_sympy, or fit a model of "
            "PySINDy in discrete time to the data"
        )
    import pysindy

    signature, n_x, n = model.signature, model.signature.n_x, model.signature.n_x + model.signature.n_u

    def _evaluate(feature: Feature, *columns: Any) -> Any:
        z = torch.stack([torch.as_tensor(np.asarray(c, dtype=np.float64)) for c in columns], -1)
        return Library(signature, [feature])(z[..., :n_x], z[..., n_x:])[..., 0].numpy()

    features, arguments = model.library.features, ", ".join(f"z{i}" for i in range(n))
    library = pysindy.CustomLibrary(
        # PySINDy counts the arguments, so that they need names.
        [eval(f"lambda {arguments}: call({arguments})", {"call": partial(_evaluate, f)}) for f in features],
        [lambda *_, f=f: f.name() for f in features],
    )
    theirs = pysindy.SINDy(optimizer=pysindy.STLSQ(threshold=0.0, alpha=0.0), feature_library=library)
    points = np.random.default_rng(0).uniform(0.1, 1.0, (len(features) + 1, n))
    names = [*signature.state_names, *signature.input_names]
    theirs.fit(points[:, :n_x], t=1.0, x_dot=points[:, :n_x], u=points[:, n_x:], feature_names=names)
    theirs.optimizer.coef_ = model.coefficients.mT.numpy().copy()
    return theirs


def from_pysindy(theirs: Any, signature: Signature) -> SindyModel:
    """Return a sparse model with the functions and coefficients of a fitted `pysindy.SINDy`.

    Args:
        theirs: fitted model with polynomial, Fourier or custom functions that can be read from their names.
        signature: states and inputs, in the order of PySINDy's columns.

    Raises:
        ValueError: a function's name cannot be read, the numbers of states differ, or the model is one in discrete
            time.
    """
    import pysindy

    if isinstance(theirs, pysindy.DiscreteSINDy):
        raise ValueError(
            "from_pysindy got a model in discrete time, a DiscreteSINDy; allowed are differential equations, a SINDy: "
            "fit a SindyModel with time='discrete' to the data"
        )
    coefficients = torch.from_numpy(np.asarray(theirs.coefficients(), dtype=np.float64)).mT.contiguous()
    if coefficients.shape[1] != signature.n_x:
        raise ValueError(
            f"from_pysindy got a model of {coefficients.shape[1]} states; allowed is {signature.n_x}, as in the "
            "signature: give the signature of its data"
        )
    ours = dict(zip(theirs.feature_names, (*signature.state_names, *signature.input_names), strict=True))
    features = [parse(name).renamed(ours) for name in theirs.get_feature_names()]
    model = SindyModel(signature, Library(signature, features))
    merged = model.coefficients.clone()
    for feature, row in zip(features, coefficients, strict=True):
        merged[[f.key for f in model.library.features].index(feature.key)] += row
    model.set_coefficients(merged)
    return model


def to_sympy(model: SindyModel) -> dict[str, Any]:
    """Return dx/dt of every state as a sympy expression in symbols of the states and inputs.

    Of a difference equation it returns the next value of every state.

    Raises:
        ValueError: The model has too many terms.
    """
    import sympy

    scope = {name: getattr(sympy, name) for name in ("sin", "cos", "exp", "tanh", "sqrt", "sign")}
    scope |= {"fabs": sympy.Abs, "square": lambda z: z**2, "larger": sympy.Max}
    names, program = model.signature, right_sides(model)
    for key, variables in (("x", names.state_names), ("u", names.input_names)):
        scope[key] = [sympy.Symbol(name, real=True) for name in variables]
    for name, formula in program.lines:  # written by our own code, of numbers and known functions alone
        scope[name] = eval(formula, {}, scope)
    return {
        s: sympy.expand(eval(result, {}, scope)) for s, result in zip(names.state_names, program.results, strict=True)
    }
