"""Linear models with states that no sensor sees, from past samples: a flexible arm by what its motor measures.

What the past tells of the future is condensed to a few numbers, the states (canonical variates, Larimore 1990; with the
weights of an autoregressive model, Jansson 2003). They are turned into those of the observability form, in which each
measured state y leads a chain,

    y' = hidden_1 + b_0 u,   hidden_1' = hidden_2 + b_1 u,   ...,   hidden_k' = a (all states) + b_k u + c,

so that a hidden state is a rate of change but for what inputs add at once, and few numbers are to be fitted.

What pushes a plant at random, and lasts, is a hidden state, too: a disturbance d that adds to an input and fades,
d' = -d / T (Muske and Badgwell 2002).
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import count, pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dynasindy.identification.forecast_errors import ENOUGH_ROWS, ORDERS
from dynasindy.identification.source import USUAL
from dynasindy.sindy import SindyModel
from dynasindy.sindy.delay import delay_and_trim
from dynasindy.sindy.library import Constraints, Feature, Library, of, variable
from dynasindy.sindy.reconstruction import rate_states, reconstruct
from dynasindy.sindy.refinement import TELLING
from dynasindy.sindy.regression import least_squares
from dynasindy.sindy.shooting import choose_stretches
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

Array = NDArray[np.float64]

STRIDES = (1, 2, 4, 8, 16)
"""Every how many samples the past is read."""
FEEDTHROUGH_RATE = 50.0
"""Rate at which a state follows an input that acts at once [1 / samples]."""
DISTURBANCE = 0.1
"""Range of a disturbance [that of the input that it adds to]."""
MAX_HIDDEN = 8
"""Hidden states at most."""
ROUNDING = 1e-9
"""Part of the largest canonical variate below which one is rounding."""
RANK_TOLERANCE = 1e-3
"""Part of a rate that others leave over, below which it is no state of its own."""


@dataclass(frozen=True)
class _Predictor:
    """Hold what an autoregressive model predicts of the future by, without means.

    Attributes:
        rows: of the recording, whose past and next sample are complete, `(N,)`.
        states: canonical variates at the end of each row, those first by which it predicts most, `(N, n)`.
        y: outputs at the end of each row, `(N, n_y)`.
        u: inputs that act from there on, `(N, n_u)`.
    """

    rows: Tensor
    states: Array
    y: Array
    u: Array


@dataclass(frozen=True)
class _Realisation:
    """Hold a continuous linear model in observability form.

    Attributes:
        a: A, `(n, n)` [1/s].
        b: B, `(n, n_u)` [1/s].
        feedthrough: D, what outputs show of inputs at once, `(n_y, n_u)`.
        sizes: range of each state, `(n,)`.
        chains: places of the states of each output's chain, itself first.
    """

    a: Array
    b: Array
    feedthrough: Array
    sizes: Array
    chains: list[list[int]]


def state_space_candidates(model: SindyModel, data: Transitions) -> Iterator[list[SindyModel]]:
    """Yield linear models with one hidden state more each time, that begin where regressions on the past end.

    Of each size there are some, by samples that are ever farther apart: what is slow noise hides from those that are
    close, and what is fast has gone where they are far.

    Args:
        model: its measured states, inputs and settings.
        data: what to fit; rows that lack a sample are left out.
    """
    data = data.to(torch.float64)
    predictors = [(stride, _predictor(data.decimate(stride))) for stride in STRIDES]
    n_y = model.signature.n_x
    for n in range(n_y + 1, n_y + MAX_HIDDEN + 1):
        found = list[SindyModel]()
        for stride, past in predictors:
            if past is not None and n <= past.states.shape[1]:
                realisation = _realise(past, stride * data.dt, n, data.u_end is not None)
                found += [] if realisation is None else [_model(model, realisation, data)]
        yield found


def chain_candidates(
    of: SindyModel, data: Transitions, state: str, named: Collection[str] = ()
) -> Iterator[list[SindyModel]]:
    """Yield models that differ from another one in a measured state, which leads a chain of hidden states.

    The chain is driven by the inputs and by the other states. Their equations stay, whatever functions they have, but
    for those that read a rate that is no state any more.

    Args:
        of: a fitted model.
        data: what it was fitted to, with all of its states.
        state: which one is to lead a chain. If the rate of it was not measured, it is no state any more.
        named: rates that stay; such a one is the first of the chain behind its state.
    """
    signature, rates = of.signature, rate_states(of.library, of.constraints)
    own, unmeasured = signature.state_index(state), data.x.isnan().all(0)
    rate = next((k for k, place in rates.items() if place == own and unmeasured[k]), None)
    if rate is None and not bool(of.constraints.free[:, own].any()):
        return  # its equation is known
    data = delay_and_trim(data, of.delay)
    full = reconstruct(data, rates)
    others = [k for k in range(signature.n_x) if k != own and (not unmeasured[k] or k in rates) and k != rate]
    names = (*signature.input_names, *(signature.state_names[k] for k in others))
    alone = Signature((state,), signature.state_units[own : own + 1], names, signature.x_scale[own : own + 1])
    drivers = torch.cat([full.u, full.x[:, others]], -1)
    part = Transitions(data.x[:, [own]], drivers, data.x_next[:, [own]], data.dt, data.segment)
    blank = SindyModel(alone, Library(alone, [Feature(())]), of.regression, of.refinement)
    for found in state_space_candidates(blank, part):
        yield [_with_chain(of, chain, rate, named) for chain in found]


def with_disturbance(of: SindyModel, signal: str, time: float) -> SindyModel:
    """Return a model with a hidden state more that acts wherever an input does, each time by a coefficient of its own.

    Args:
        of: a fitted model.
        signal: the input, which its equations read.
        time: in which the disturbance fades, at first [s].
    """
    known = {*of.signature.state_names, *of.signature.input_names}
    name = next(n for k in count() if (n := f"{signal}_disturbance" + "_" * k) not in known)
    signature, features, xi = of.signature.with_state(name, "1", DISTURBANCE), of.library.features, of.coefficients
    rows = [k for k in (xi != 0).any(-1).nonzero().flatten().tolist() if signal in features[k].variables]
    through, own = [features[k].renamed({signal: name}) for k in rows], variable(name)
    more = through if own in through else [*through, own]
    library, place = Library(signature, [*features, *more], step=of.step), len(features) + more.index(own)

    def _wide(values: Tensor) -> Tensor:
        acting = torch.cat([values, values[rows]])
        return torch.nn.functional.pad(acting, (0, 1, 0, len(library) - len(acting)))

    found = SindyModel(signature, library, of.regression, of.refinement, machine_code=of.machine_code)
    free, offset, initial = _wide(of.constraints.free & (xi != 0)), _wide(of.constraints.offset), _wide(xi)
    for k, i in free[len(features) :].nonzero()[:1].tolist():  # the unit is that of the input
        free[len(features) + k, i], offset[len(features) + k, i] = False, initial[len(features) + k, i]
    free[place, -1], initial[place, -1] = True, -1 / time
    found.constraints, found.initial, found.initial_delay = Constraints(free, offset), initial, of.delay
    return found


def _with_chain(of: SindyModel, chain: SindyModel, rate: int | None, named: Collection[str]) -> SindyModel:
    """Return a model with the equations of a chain in place of those of its first state and of the rate of that."""
    old, new, features, kept = of.signature, chain.signature, chain.library.features, set[str]()
    if rate is not None and old.state_names[rate] in named:
        own, _, *hidden = new.state_names
        names = own, old.state_names[rate], *hidden
        features = tuple(each.renamed(dict(zip(new.state_names, names, strict=True))) for each in features)
        new, kept, rate = replace(new, state_names=names), {own}, None
    every = [row for s in (old, new) for row in zip(s.state_names, s.state_units, s.x_scale, strict=True)]
    signature = replace(old, state_names=(), state_units=(), x_scale=())
    for k, (name, unit, scale) in enumerate(every):
        if k != rate and name not in signature.state_names:
            signature = signature.with_state(name, unit, scale)
    variables = {*signature.state_names, *signature.input_names}
    both, chained = {each.key: each for each in (*of.library.features, *features)}, Library(new, features)
    library = Library(signature, [each for each in both.values() if each.variables <= variables])
    led = torch.tensor([name in new.state_names and name not in kept for name in signature.state_names])

    def _both(others: Tensor, own: Tensor) -> Tensor:
        return torch.where(led, library.aligned(chained, own), library.aligned(of.library, others))

    assert chain.initial is not None
    found = SindyModel(signature, library, of.regression, of.refinement, machine_code=of.machine_code)
    free = _both(of.constraints.free, chain.constraints.free)
    found.constraints = Constraints(free, _both(of.constraints.offset, chain.constraints.offset))
    found.initial = _both(of.coefficients, chain.initial)
    found.initial_delay = of.delay
    return found


def _predictor(data: Transitions) -> _Predictor | None:
    """Return canonical variates of as many past samples as predict the next one best by Akaike's criterion."""
    best: tuple[float, Tensor, Tensor, Tensor] | None = None
    if len(data) < max(ORDERS):
        return None
    offset = data.x.nanmean(0), data.u.mean(0)
    x, u, x_next = data.x - offset[0], data.u - offset[1], data.x_next - offset[0]
    every = torch.arange(max(ORDERS) - 1, len(data))
    every = every[data.segment[every] == data.segment[every - max(ORDERS) + 1]]
    for order in ORDERS[1:]:
        back = every.unsqueeze(-1) - torch.arange(order)
        columns = torch.cat([x[back], u[back]], -1).flatten(1)
        complete = ~(columns.isnan().any(-1) | x_next[every].isnan().any(-1))
        rows, columns = every[complete], columns[complete]
        if len(rows) < 3 * columns.shape[1]:
            break
        some = choose_stretches(len(rows), ENOUGH_ROWS)
        weights = least_squares(columns[some], x_next[rows[some]])
        left = x_next[rows[some]] - columns[some] @ weights
        cost = int(some.sum()) * float(torch.linalg.slogdet(left.mT @ left / len(left))[1]) + 2 * weights.numel()
        if best is None or cost < best[0]:
            best = cost, rows, columns, weights
    if best is None:
        return None
    _, rows, columns, weights = best
    n_y, n_z = x.shape[1], x.shape[1] + u.shape[1]
    blocks = weights.mT.unflatten(1, (-1, n_z))  # of y at the next sample by each past one, (n_y, order, n_z)
    order, scale = blocks.shape[1], x_next[rows].std(0).clamp_min(1e-300)
    hankel = torch.zeros(order, n_y, order, n_z, dtype=torch.float64)
    for k in range(order):
        hankel[k, :, : order - k] = blocks[:, k:] / scale[:, None, None]
    hankel = hankel.flatten(0, 1).flatten(1)
    root = torch.linalg.qr(columns / len(columns) ** 0.5, mode="r")[1].mT
    future, sizes, _ = torch.linalg.svd(hankel @ root, full_matrices=False)
    clear = sizes > ROUNDING * sizes[0]
    weights_of_states = hankel.mT @ future[:, clear] / sizes[clear]
    after = (rows + 1).clamp_max(len(data) - 1)
    return _Predictor(rows, (columns @ weights_of_states).numpy(), x_next[rows].numpy(), u[after].numpy())


def _realise(past: _Predictor, dt: float, n: int, linear: bool) -> _Realisation | None:
    """Return a model of so many states; None where it has no continuous form.

    Of inputs that move `linear` between samples, not of held ones, an output may show some at once.
    """
    from scipy.linalg import logm

    states, rows = past.states[:, :n], past.rows.numpy()
    on = np.flatnonzero(np.diff(rows) == 1)
    if len(on) < 3 * (n + past.u.shape[1]):
        return None
    reads, _, _, _ = np.linalg.lstsq(states, past.y, rcond=None)
    error, feedthrough = past.y - states @ reads, np.zeros((past.y.shape[1], past.u.shape[1]))
    if linear:
        wide = np.concatenate([states, past.u], -1)[on]
        both, _, _, _ = np.linalg.lstsq(wide, past.y[on], rcond=None)
        left = past.y[on] - wide @ both
        if (left**2).sum() * TELLING < (error[on] ** 2).sum():
            reads, feedthrough = both[:n], both[n:].T
            error = past.y - states @ reads - past.u @ feedthrough.T
    known = np.concatenate([states, past.u, error], -1)[on]
    steps, _, _, _ = np.linalg.lstsq(known, states[on + 1], rcond=None)
    n_u = past.u.shape[1]
    both = np.eye(n + n_u)
    both[:n, : n + n_u] = steps[: n + n_u].T
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # of accuracy, which the fit mends
        rates = logm(both) / dt
    if not np.isfinite(rates).all() or np.abs(rates.imag).max() > 1e-6 * np.abs(rates).max():
        return None
    a, b = rates.real[:n, :n], rates.real[:n, n:]
    # Rates of outputs, the lowest first, are states of their own as long as others do not tell them.
    chosen, chains = list(reads.T), [[k] for k in range(reads.shape[1])]
    growing = list(range(len(chains)))
    while len(chosen) < n and growing:
        left = list[tuple[float, int, Array]]()
        for k in growing:
            row = chosen[chains[k][-1]] @ a
            basis = np.linalg.qr(np.array(chosen).T)[0]
            left.append((float(np.linalg.norm(row - basis @ (basis.T @ row)) / np.linalg.norm(row)), k, row))
        apart, k, row = max(left, key=lambda each: (-len(chains[each[1]]), each[0]))
        if apart < RANK_TOLERANCE:
            growing.remove(k)
            continue
        chains[k].append(len(chosen))
        chosen.append(row)
    transformation = np.array(chosen)
    if len(chosen) < n or np.linalg.cond(transformation / np.linalg.norm(transformation, axis=1, keepdims=True)) > 1e8:
        return None
    sizes = np.quantile(np.abs(states @ transformation.T), USUAL, axis=0)
    a, b = transformation @ a @ np.linalg.inv(transformation), transformation @ b
    return _Realisation(a, b, feedthrough, sizes, chains)


def _model(model: SindyModel, linear: _Realisation, data: Transitions) -> SindyModel:
    """Return a model that begins at a realisation."""
    a, b, feedthrough, chains, signature = linear.a, linear.b, linear.feedthrough, linear.chains, model.signature
    names, inputs, place = list(signature.state_names), list(signature.input_names), len(chains)
    free = (name for k in count(1) if (name := f"hidden_{k}") not in (*names, *inputs))
    led = {k: before for chain in chains for before, k in pairwise(chain)}
    for k in range(place, len(a)):
        unit = signature.rate_unit(signature.state_names[led[k]])
        signature = signature.with_state(next(free), unit, float(linear.sizes[k]) or 1.0)
    names, more, at_once = list(signature.state_names), list[Feature](), dict[str, tuple[str, str]]()
    for k, name in enumerate(inputs):
        if feedthrough[:, k].any():
            lagging = next(n for n in (f"{name}_lagging" + "_" * k for k in count()) if n not in (*names, *inputs))
            signature = signature.with_state(lagging, "1")
            own = of("ahead", name, lagging)
            more.append(own)
            at_once[name] = lagging, own.name()
    library = Library(signature, [Feature(()), *map(variable, names), *map(variable, inputs), *more])
    one, rate = library.names[0], FEEDTHROUGH_RATE / data.dt
    allowed, fixed, initial = dict[str, list[str]](), dict[str, dict[str, float]](), dict[str, dict[str, float]]()
    for lagging, own_name in at_once.values():
        allowed[lagging], fixed[lagging] = [], {own_name: rate}
    means = data.x.nanmean(0).numpy(), data.u.mean(0).numpy()
    rest = np.zeros(len(a))
    rest[:place] = means[0] - feedthrough @ means[1]
    for chain in chains:  # at rest: what follows in a chain is what inputs add, the other way round
        for before, k in pairwise(chain):
            rest[k] = -b[before] @ means[1]
    for chain in chains:
        for before, k in pairwise(chain):
            fixed[names[before]] = {names[k]: 1.0}
            allowed[names[before]] = [*inputs]
            initial[names[before]] = dict(zip(inputs, b[before].tolist(), strict=True))
        last = chain[-1]
        allowed[names[last]] = [one, *names, *inputs]
        initial[names[last]] = dict(zip([*names, *inputs], [*a[last].tolist(), *b[last].tolist()], strict=True))
        initial[names[last]][one] = float(-a[last] @ rest - b[last] @ means[1])
        for name, (_, own_name) in at_once.items():  # what is measured is beyond its chain what acts at once
            k = inputs.index(name)
            initial[names[last]][name] -= float(a[last, :place] @ feedthrough[:, k])
            allowed[names[chain[0]]].append(own_name)
            initial[names[chain[0]]][own_name] = float(feedthrough[chain[0], k]) * rate
    found = SindyModel(
        signature,
        library,
        model.regression,
        model.refinement,
        allowed=allowed,
        fixed=fixed,
        initial=initial,
        machine_code=model.machine_code,
    )
    found.initial_delay = 0.0
    return found
