"""What the data can tell about the functions of a library, in figures and in words."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from dynasindy.sindy.library import Feature, Library
from dynasindy.sindy.regression import RunningSums

CLEAR = 1e6
"""Condition number below which functions are well apart."""


@dataclass(frozen=True)
class Identifiability:
    """Describe how well the samples separate the candidate functions.

    Attributes:
        rank: number of independent directions among the functions.
        n_features: number of functions.
        condition: largest over smallest singular value, columns scaled to unit norm.
        weakest: functions in the least excited direction, with their weight in it, heaviest first.
        advice: sentences that say what to excite more.
    """

    rank: int
    n_features: int
    condition: float
    weakest: tuple[tuple[str, float], ...]
    advice: tuple[str, ...]

    @classmethod
    def of(cls, library: Library, sums: RunningSums) -> Identifiability:
        """Judge the samples behind running sums.

        Args:
            library: candidate functions.
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
            tuple(_advice(library, [n for n, _ in weakest], sums, rank, condition)),
        )

    def to_text(self) -> str:
        """Write which functions the data can tell apart, and what to excite, in a few lines."""
        count, names = self.n_features, ", ".join(name for name, _ in self.weakest)
        condition = f"condition number {self.condition:.2g}"
        if self.rank < count:
            which = f"{count - self.rank} of {count} candidate functions"
            first = f"{which} cannot be told apart from others by these data: {names}"
        elif self.condition < CLEAR:
            told = f"the data can tell all {count} candidate functions apart"
            return f"{told} ({condition}; below {CLEAR:,.0f} is good)"
        else:
            first = (
                f"these of {count} candidate functions can hardly be told apart by these data ({condition}): {names}"
            )
        return "\n".join([first, *self.advice])


def _advice(library: Library, weak: list[str], sums: RunningSums, rank: int, condition: float) -> list[str]:
    """Say what these data cannot tell, and what to excite where they show that it was not."""
    if rank == len(library) and condition < CLEAR:
        return ["the functions are well apart: the data can tell them from each other"]
    features, norms = {f.name(): f for f in library.features}, sums.norms()
    inputs = [n for n in library.signature.input_names if n in library.names]
    silent = [n for n in inputs if float(norms[library.index(n)]) == 0]
    sentences = [f"{name} was zero all the time: excite it" for name in silent]
    involved = set().union(*(features[n].variables for n in weak)) if weak else set()
    moved = [n for n in inputs if n in involved and n not in silent]
    if len(moved) > 1 and all(_alike(library, sums, moved[0], other) for other in moved[1:]):
        sentences.append(f"{' and '.join(moved)} move together: give the inputs different signals")
    for name in sorted(involved):
        mine = [features[n] for n in weak if name in features[n].variables]
        if any(_alike(library, sums, f.name(), _without_abs(f, name).name()) for f in mine):
            sentences.append(
                f"{name} kept its sign, so that |{name}| is no other function: the model holds for that sign"
            )
        elif involved == {name} and any(f.function in ("sin", "cos") for g in mine for f in g.factors):
            sentences.append(f"functions of {name} look alike over its range: let it swing further")
    return sentences or [f"{', '.join(weak)} look alike: these data do not tell them apart"]


def _without_abs(feature: Feature, name: str) -> Feature:
    """Return a function with a variable itself where its size stands."""
    of_size = [f.function == "abs" and f.variables == (name,) for f in feature.factors]
    return Feature.of(
        replace(f, function="id") if size else f for f, size in zip(feature.factors, of_size, strict=True)
    )


def _alike(library: Library, sums: RunningSums, one: str, other: str) -> bool:
    """Tell whether two functions are multiples of each other on the samples."""
    if one == other or not {one, other} <= set(library.names):
        return False
    columns = sums.theta()
    a, b = columns[:, library.index(one)], columns[:, library.index(other)]
    return float((a @ b).abs()) > (1 - 1e-6) * float(a.norm() * b.norm())
