"""Name what a model misses: functions outside its library that its errors look like."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import torch

from dynasindy.sindy.difference_equation import stepwise
from dynasindy.sindy.library import Feature, Library, of, variable
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.regression import simpson_form
from dynasindy.systems.transitions import Transitions


@dataclass(frozen=True)
class Missing:
    """Say what the unexplained part of one equation looks like.

    Attributes:
        state: whose equation it is.
        unexplained: part of the rate of change that is unexplained, relative.
        function: candidate that explains most of the rest.
        share: part of the rest that it explains, between 0 and 1.
    """

    state: str
    unexplained: float
    function: str
    share: float

    def __str__(self) -> str:
        """Write it as a sentence."""
        return (
            f"{self.state}': {100 * self.unexplained:.2g} % unexplained; {self.function}, which its equation may not "
            f"use, would explain {100 * self.share:.0f} % of that"
        )


def diagnose(model: SindyModel, data: Transitions, least: float = 0.005) -> list[Missing]:
    """Try friction, products and squares on the errors of each equation.

    Args:
        model: a fitted model.
        data: transitions, N rows.
        least: unexplained part of a rate of change below which an equation is complete.

    Returns:
        One entry for each equation that is not complete, whatever was found.
    """
    candidates = _candidates(model)
    if model.step is not None:
        _, data = stepwise(model.library, data)
    theta, dx = simpson_form(model.library, model, data)
    others, _ = simpson_form(candidates, model, data)
    found = []
    for i, state in enumerate(model.signature.state_names):
        error = dx[:, i] - theta @ model.coefficients[:, i]
        unexplained = float(error.norm() / dx[:, i].norm().clamp_min(1e-300))
        if unexplained < least:
            continue
        active = theta[:, model.coefficients[:, i] != 0]
        basis = torch.linalg.qr(active / active.norm(dim=0))[0]
        rest = error - basis @ (basis.mT @ error)
        columns = others / others.norm(dim=0).clamp_min(1e-300)
        columns = columns - basis @ (basis.mT @ columns)
        norms = columns.norm(dim=0)
        share = (columns.mT @ rest).square() / (norms * rest.norm()).square().clamp_min(1e-300)
        share = torch.where(norms > 1e-4, share, 0.0)
        found.append(Missing(state, unexplained, candidates.names[int(share.argmax())], float(share.max())))
    return found


def _candidates(model: SindyModel) -> Library:
    """Collect friction (sign), even and odd squares, trigonometric functions, all doubled by products of variables."""
    signature = model.signature
    names = [*signature.state_names, *signature.input_names]
    features: list[Feature] = [variable(n) for n in names]
    features += [variable(a) * variable(b) for a, b in combinations_with_replacement(names, 2)]
    for n in names:
        features += [of("sign", n), of("tanh", n, frequency=20.0), of("abs", n), variable(n) * of("abs", n)]
    for angle, unit in zip(signature.state_names, signature.state_units, strict=True):
        if unit == "rad":
            s, c = of("sin", angle), of("cos", angle)
            features += [s, c, s * c, s * s]
            features += [f * g for n in names for f in (s, c) for g in (variable(n), variable(n) * of("abs", n))]
    return Library(signature, [*features, *model.library.features])
