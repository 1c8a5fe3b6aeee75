"""What the data can tell about the functions of a library, in figures and in words."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dynasindy.world_models.library import Library
from dynasindy.world_models.regression import RunningSums


@dataclass(frozen=True)
class Identifiability:
    """Describe how well the samples separate the candidate functions.

    Attributes:
        rank: number of independent directions among the functions.
        n_features: number of functions.
        condition: largest over smallest singular value, columns scaled to unit norm.
        weakest: functions in the least excited direction, with their weight in it, heaviest first.
        standard_error: of each non-zero coefficient, zero elsewhere, `(n_features, n_x)`.
        advice: sentences that say what to excite more.
    """

    rank: int
    n_features: int
    condition: float
    weakest: tuple[tuple[str, float], ...]
    standard_error: Tensor
    advice: tuple[str, ...]

    @classmethod
    def of(cls, library: Library, coefficients: Tensor, sums: RunningSums) -> Identifiability:
        """Judge the samples behind running sums.

        Args:
            library: candidate functions.
            coefficients: Xi of the fit, `(n_features, n_x)`.
            sums: the samples.
        """
        norms = sums.norms()[: sums.n_features]
        scaled = sums.theta() / torch.where(norms > 0, norms, 1.0)
        _, singular, directions = torch.linalg.svd(scaled)
        singular = torch.cat([singular, torch.zeros(sums.n_features - len(singular))])
        rank = int((singular > 1e-10 * singular[0]).sum())
        weights = directions[-1]
        order = weights.abs().argsort(descending=True)
        weakest = [(library.names[k], float(weights[k])) for k in order.tolist() if abs(float(weights[k])) > 0.2]
        if bool((norms == 0).any()):
            weakest = [(library.names[k], 1.0) for k in (norms == 0).nonzero().flatten().tolist()]
        condition = float(singular[0] / singular[-1]) if float(singular[-1]) > 0 else float("inf")
        return cls(
            rank,
            sums.n_features,
            condition,
            tuple(weakest),
            standard_errors(coefficients, sums),
            tuple(_advice(library, [n for n, _ in weakest], norms, rank, condition)),
        )

    def to_text(self) -> str:
        """Write rank, condition, weakest direction and advice in a few lines."""
        direction = ", ".join(f"{w:+.2f} {n}" for n, w in self.weakest)
        alike = "; below it, some functions are sums of others on these data" if self.rank < self.n_features else ""
        lines = [
            f"rank {self.rank} of {self.n_features} functions, condition number {self.condition:.2g}{alike}",
            f"least excited direction: {direction}",
        ]
        return "\n".join([*lines, *self.advice])


def standard_errors(coefficients: Tensor, sums: RunningSums) -> Tensor:
    """Return the standard error of each non-zero coefficient, `(n_features, n_x)`, independent errors assumed."""
    errors = torch.zeros_like(coefficients)
    residual = sums.residual(coefficients)
    norms = sums.norms()[: sums.n_features]
    scaled = sums.theta() / torch.where(norms > 0, norms, 1.0)
    for i in range(coefficients.shape[1]):
        active = coefficients[:, i].nonzero().flatten()
        inverse = torch.linalg.pinv(scaled[:, active])
        sigma = residual[i] / max(sums.count - len(active), 1) ** 0.5
        errors[active, i] = sigma * inverse.square().sum(-1).sqrt() / norms[active]
    return errors


def _advice(library: Library, weak: list[str], norms: Tensor, rank: int, condition: float) -> list[str]:
    """Say what to excite more; nothing where the functions are well apart."""
    signature = library.signature
    if rank == len(library) and condition < 1e6:
        return ["the functions are well apart: the data can tell them from each other"]
    features = {f.name(): f for f in library.features}
    silent = [n for n in signature.input_names if n in library.names and float(norms[library.index(n)]) == 0]
    sentences = [f"{name} was zero all the time: excite it" for name in silent]
    involved = set().union(*(features[n].variables for n in weak)) if weak else set()
    inputs = [n for n in signature.input_names if n in involved and n not in silent]
    if len(inputs) > 1:
        sentences.append(f"{' and '.join(inputs)} move together: give the inputs different signals")
    for name in sorted(involved):
        one_signed = {"abs"} & {f.function for n in weak for f in features[n].factors if name in f.variables}
        if one_signed:
            sentences.append(f"{name} kept its sign, so that |{name}| is no other function: let it change sign")
        elif any(f.function in ("sin", "cos") for n in weak for f in features[n].factors if name in f.variables):
            sentences.append(f"functions of {name} look alike over its range: let it swing further")
    if not sentences:
        sentences.append(f"{', '.join(weak)} look alike: excite {', '.join(sorted(involved))} more and differently")
    return sentences
