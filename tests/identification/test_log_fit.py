"""A state more is looked for where equations lack something, and believed where with it they predict."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from dynasindy.envs.rollout_data import record_plant
from dynasindy.excitation import Multisine
from dynasindy.findings import note, weak
from dynasindy.identification import log_fit as module
from dynasindy.identification.forecast_errors import ForecastErrors, forecast_errors
from dynasindy.identification.log_fit import LogFit, fit_log
from dynasindy.identification.source import Source
from dynasindy.identification.verdict import unresolved
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.sindy.fit_report import Refined
from dynasindy.sindy.lag_states import LagStateCandidate
from dynasindy.systems import Diverged, Pendulum, Signature, System
from dynasindy.systems.transitions import Transitions


@pytest.fixture
def source():
    data = record_plant(Pendulum(), Multisine(1, duration=6, dt=0.05, amplitude=[0.6], seed=0).samples(0.01), 0.01)
    place = torch.arange(len(data))
    return Source(Pendulum().signature, data.select(place < 400), data.select(place >= 400), logged=True)


@pytest.fixture
def model(source):
    made = SindyModel(source.signature, ["1", "u", "Omega", "sin(theta)"], Regression("bic"), known={"theta": "Omega"})
    made.fit(source.training)
    return made


def lag(source):
    """Return a model in which the input acts through a lag."""
    wide = source.signature.with_state("u_lagging", "1")
    words = ["1", "u_lagging", "Omega", "sin(theta)", "(u - u_lagging)"]
    own = {"Omega": words[:-1], "u_lagging": words[-1:]}
    start = {"u_lagging": {words[-1]: 10.0}, "Omega": {"u_lagging": 1.0}}
    made = SindyModel(wide, words, Regression("bic"), known={"theta": "Omega"}, allowed=own, initial=start)
    return LagStateCandidate(made, "u", 1.0)


def test_a_state_is_looked_for_only_where_something_lacks_and_believed_only_where_it_helps(source, model, monkeypatch):
    asked = []

    def _trials(given, data):
        asked.append(given)
        return [lag(source)]

    monkeypatch.setattr(module, "lag_state_candidates", _trials)
    assert fit_log(model, source).hidden == [] and not asked
    monkeypatch.setattr(module, "unresolved", lambda *given: torch.ones(1))
    plain = fit_log(model, source)  # with a lag that is not there nothing is better
    assert plain.model is model and plain.source is source and plain.follower is None and len(asked) == 1
    assert plain.hidden == [plain.sought] == [weak("fit.no_lag_state", what="a state")]
    simulated = Source(source.signature, source.training, source.validation)
    assert fit_log(model, simulated).model is model and len(asked) == 1  # of a plant that is known none is looked for
    monkeypatch.setattr(module, "_better", lambda *given: True)
    found = fit_log(model, source)
    assert found.model.signature.state_names == (*model.signature.state_names, "u_lagging")
    assert found.source.signature == found.model.signature and found.report is not plain.report
    assert found.source.training.x.shape[-1] == found.source.validation.x.shape[-1] == 3
    assert [each.code for each in found.hidden] == ["model.lag_state"] and found.hidden[0].values["signal"] == "u"


def test_no_lag_is_looked_for_while_a_rate_is_missing(source, model, monkeypatch):
    monkeypatch.setattr(module, "unresolved", lambda *given: torch.ones(1))
    monkeypatch.setattr(module, "lag_state_candidates", lambda *given: pytest.fail("a lag was looked for"))
    monkeypatch.setattr(module, "find_missing_rates", lambda *given: ["theta"])
    assert fit_log(model, source).model is model


def test_no_lag_is_looked_for_in_a_difference_equation_that_misses_its_log():
    """a[k+1] = 0.9 a + 0.1 u + 0.02 b with b[k+1] = 0.98 b + 0.2 u, which nobody measured."""
    u, states = np.random.default_rng(0).uniform(-1, 1, 40).repeat(10), [np.zeros(2)]
    for held in u:
        states.append(np.array([[0.9, 0.02], [0.0, 0.98]]) @ states[-1] + np.array([0.1, 0.2]) * held)
    seen = torch.from_numpy(np.stack(states)[:, :1].copy())
    data, place = Transitions.from_trajectory(seen, torch.from_numpy(u).unsqueeze(-1), 0.5), torch.arange(400)
    signature = Signature(("a",), ("-",), ("u",), (1.0,))
    source = Source(signature, data.select(place < 300), data.select(place >= 300), logged=True)
    model = SindyModel(signature, ["a", "u"], Regression("bic"), time="discrete")
    found = fit_log(model, source)
    missed = forecast_errors(model, source.training, source.validation)
    assert bool(unresolved(missed, signature).any())  # so it would be looked for
    assert found.hidden == [] and found.model is model


def test_a_fit_that_fails_leaves_the_model(source, model, monkeypatch):
    class Failing(SindyModel):
        def fit(self, transitions):
            raise Diverged("no")

    monkeypatch.setattr(module, "unresolved", lambda *given: torch.ones(1))
    wide = Failing(source.signature, ["u"])
    monkeypatch.setattr(module, "lag_state_candidates", lambda *given: [LagStateCandidate(wide, "u", 1.0)])
    assert fit_log(model, source).model is model
    monkeypatch.setattr(module, "lag_state_candidates", lambda *given: [])
    assert fit_log(model, source).model is model


def test_a_trial_that_fails_does_not_keep_the_next_one_from_being_tried(source, model, monkeypatch):
    class Failing(SindyModel):
        def fit(self, transitions):
            raise Diverged("no")

    wide = Failing(source.signature, ["u"])
    second = lag(source)
    monkeypatch.setattr(module, "lag_state_candidates", lambda *given: [LagStateCandidate(wide, "theta", 2.0), second])
    monkeypatch.setattr(module, "unresolved", lambda *given: torch.ones(1))
    monkeypatch.setattr(module, "_better", lambda *given: True)
    assert fit_log(model, source).model is second.model


def forecasts(*errors):
    model = torch.tensor(errors, dtype=torch.float64)
    same = torch.ones_like(model)
    return ForecastErrors((0.1, 0.2), 1.0, 10, model, same, same, torch.tensor([1e-4, 1e-4], dtype=torch.float64), 4)


def test_what_runs_away_or_is_exact_counts_and_does_not_decide():
    """Errors count from what the sensor resolves, 1e-4, to ten ranges; the geometric mean has to fall below 0.7."""
    signature = Signature(("q", "w"), ("rad", "rad/s"), ("u",), (1.0, 1.0))
    lost = forecasts([math.inf, 0.1], [0.1, 0.1])
    worse = forecasts([9.0, 10.0], [10.0, 10.0])
    assert not module._better(lost, worse, signature)  # 0.9 * 100^3 instead of minus infinity
    assert module._better(lost, forecasts([math.inf, 0.01], [0.01, 0.01]), signature)
    assert module._better(forecasts([0.0, 0.1], [0.1, 0.1]), forecasts([0.0, 0.01], [0.01, 0.01]), signature)
    assert not module._better(forecasts([0.1, 0.1], [0.1, 0.1]), forecasts([0.08] * 2, [0.08] * 2), signature)
    # Ten ranges of 2 rad and 0.5 rad/s: 20 and 5, whatever beyond; half of all that is far less.
    uneven = Signature(("q", "w"), ("rad", "rad/s"), ("u",), (2.0, 0.5))
    assert module._better(forecasts([18.0, 4.0], [18.0, 4.0]), forecasts([9.0, 2.0], [9.0, 2.0]), uneven)
    assert not module._better(forecasts([80.0, 20.0], [80.0, 20.0]), forecasts([20.0, 5.0], [20.0, 5.0]), uneven)
    unseen = forecasts([0.1, math.nan], [0.1, math.nan])
    assert module._better(unseen, forecasts([0.01, math.nan], [0.01, math.nan]), signature)


def tank(bend):
    """Noisy log of y' = 2 u - y / 2 - bend y^2, and what a fit of squares and products finds, said to be in pieces."""
    signature = Signature(("y",), ("m",), ("u",), (3.0,))

    class Tank(System):
        def forward(self, x, u):
            return 2 * u - 0.5 * x - bend * x.square()

    u = Multisine(1, duration=40, dt=0.1, amplitude=[0.5], offset=[0.5], seed=0).samples(0.1)
    data = record_plant(Tank(signature), u, 0.1)
    x = torch.cat([data.x[:1], data.x_next])
    x = x + 0.02 * torch.randn(x.shape, generator=torch.Generator().manual_seed(1), dtype=x.dtype)
    data = Transitions.from_trajectory(x, data.u, 0.1)
    place = torch.arange(len(data))
    log = Source(signature, data.select(place < 300), data.select(place >= 300), logged=True)
    model = SindyModel(signature, "polynomial", Regression("bic"), Refinement("trajectory"))
    report = replace(model.fit(log.training), in_pieces=True)
    if not bend:  # what errors that last would let in
        model.set_coefficients(model.coefficients.index_fill(0, torch.tensor(model.library.index("y^2")), -0.03))
    return LogFit(model, log, report)


@pytest.mark.parametrize(("bend", "straight"), [(0.0, True), (0.3, False)])
def test_what_bends_for_nothing_is_left_out_of_a_fit_in_pieces(bend, straight):
    """The plant itself is straight, or its outflow grows with the square of its level."""
    found = tank(bend)
    names, before = found.model.library.names, module._forecast(found)
    kept = module._straighter(found, before)[0].model.coefficients[:, 0]
    bent = {name for name, size in zip(names, kept.tolist(), strict=True) if size} & {"y^2", "y u", "u^2"}
    assert (bent == set()) == straight
    if straight:
        assert kept[names.index("u")] == pytest.approx(2.0, rel=0.05)
        assert kept[names.index("y")] == pytest.approx(-0.5, rel=0.05)
        explained = replace(found, report=replace(found.report, in_pieces=False))
        good = replace(before, model=before.resolution.expand_as(before.model))
        assert module._straighter(explained, good)[0] is explained
        assert module._straighter(explained, before)[0] is not explained  # the last part of the log is missed


def test_a_state_that_follows_is_fitted_without_products_and_squares_too():
    """Of y' = 2 a - y / 2, a' = (u - a) / 1.5 nothing bends."""
    signature = Signature(("y", "a"), ("m", "1"), ("u",), (3.0, 1.0))

    class Lagging(System):
        def forward(self, x, u):
            y, a = x.unbind(-1)
            return torch.stack([2 * a - 0.5 * y, (u[..., 0] - a) / 1.5], -1)

    u = Multisine(1, duration=40, dt=0.1, amplitude=[0.5], seed=0).samples(0.1)
    data = record_plant(Lagging(signature), u, 0.1)
    seen = replace(data, x=data.x[:, :1], x_next=data.x_next[:, :1])
    log = Source(Signature(("y",), ("m",), ("u",), (3.0,)), seen, seen, logged=True)
    model = SindyModel(log.signature, "polynomial", Regression("bic"), Refinement("trajectory"))
    model.fit(log.training)
    bent, straight = list(module._wider(model, log, model.refinement))[:2]
    assert bent.model.library.names == straight.model.library.names
    found = dict(zip(straight.model.library.names, straight.model.coefficients[:, 0].tolist(), strict=True))
    wanted = dict.fromkeys(found, 0.0) | {"u_lagging": 2.0, "y": -0.5}
    assert found == pytest.approx(wanted, rel=0.01, abs=0.01)
    told = {"signal": "u", "seconds": pytest.approx(1.5, rel=3e-3), "is_input": True, "state": "u_lagging"}
    assert straight.follower == note("model.lag_state", **told)
    assert (
        note("fit.linear_preferred") in straight.report.findings
        and note("fit.linear_preferred") not in bent.report.findings
    )
    free = bent.model.constraints.free & ~straight.model.constraints.free
    bends = {name for name, lost in zip(bent.model.library.names, free.any(-1).tolist(), strict=True) if lost}
    assert bends == {"y^2", "y u_lagging", "u_lagging^2"}


def bowl(words=("1", "y", "u", "y^2")):
    """Log of y' = 2 u - y / 2, fitted at once, and said to be met in pieces and by a square that is not there."""
    signature = Signature(("y",), ("m",), ("u",), (3.0,))

    class Bowl(System):
        def forward(self, x, u):
            return 2 * u - 0.5 * x

    u = Multisine(1, duration=20, dt=0.1, amplitude=[0.5], offset=[0.5], seed=0).samples(0.1)
    data = record_plant(Bowl(signature), u, 0.1)
    place = torch.arange(len(data))
    log = Source(signature, data.select(place < 150), data.select(place >= 150), logged=True)
    model = SindyModel(signature, list(words), Regression("bic"))
    report = replace(model.fit(log.training), in_pieces=True)
    model.set_coefficients(model.coefficients.index_fill(0, torch.tensor(model.library.index("y^2")), -0.03))
    return LogFit(model, log, report)


def of_one(error):
    """ForecastErrors of one state that miss by so much over both horizons [m]."""
    model = torch.full((2, 1), error, dtype=torch.float64)
    return ForecastErrors((0.1, 0.2), 1.0, 10, model, model, model, torch.tensor([1e-6], dtype=torch.float64), 4)


@pytest.mark.parametrize(("part", "straight"), [(0.99, True), (1.01, False), (1.4, False)])
def test_what_bends_is_left_out_only_where_no_error_is_larger_without(part, straight, monkeypatch):
    found = bowl()
    monkeypatch.setattr(module, "_forecast", lambda given: of_one(0.1 * part))
    kept = module._straighter(found, of_one(0.1))[0]
    assert (kept is not found) == straight
    if straight:
        assert float(kept.model.coefficients[kept.model.library.index("y^2"), 0]) == 0.0


def test_a_fit_without_what_bends_begins_where_the_one_with_it_ended_or_at_the_guess_that_was_given():
    """A hidden state has no first guess but the one that was given; what was fitted with squares may have lost it."""
    model = bowl().model
    model.delay = 0.3
    bend = model.library.index("y^2")
    ended = model.coefficients.index_fill(0, torch.tensor(bend), 0.0)
    bare = module._straight(model)
    assert torch.equal(bare.initial, ended) and bare.initial_delay == 0.3 and bool(ended.any())
    model.initial, model.initial_delay = torch.full_like(ended, 7.0), 0.2
    bare = module._straight(model)
    assert torch.equal(bare.initial, torch.full_like(ended, 7.0).index_fill(0, torch.tensor(bend), 0.0))
    assert bare.initial_delay == 0.2


@pytest.mark.parametrize(("friction", "straight"), [(0.0, True), (-0.4, False)])
def test_a_model_with_functions_that_are_no_polynomials_keeps_its_squares(friction, straight, monkeypatch):
    """Dry friction is a function of its own, which a fit of straight functions alone would leave out."""
    found = bowl(("1", "y", "u", "y^2", "tanh(50 y)"))
    xi = found.model.coefficients.clone()
    xi[found.model.library.index("tanh(50 y)"), 0] = friction
    found.model.set_coefficients(xi)
    monkeypatch.setattr(module, "_forecast", lambda given: of_one(0.05))
    assert (module._straighter(found, of_one(0.1))[0] is not found) == straight


@pytest.mark.parametrize(("part", "taken"), [(0.8, True), (0.95, False), (1.3, False)])
def test_what_was_set_aside_is_taken_where_it_predicts_better_by_a_tenth(part, taken, monkeypatch):
    """Errors of the two fits on the kept part of the log are given."""
    found = bowl()
    xi = found.model.coefficients.clone()
    kept = Refined(found.model.library, 0.5 * xi, in_pieces=True)
    found.model.refinement = Refinement("auto")
    found = replace(found, report=replace(found.report, aside=kept))
    monkeypatch.setattr(module, "_forecast", lambda given: of_one(0.1 * part))
    after, errors = module._whole(found, of_one(0.1))
    assert torch.equal(after.model.coefficients, (0.5 if taken else 1.0) * xi)
    assert float(errors.model[0, 0]) == pytest.approx(0.1 * (part if taken else 1.0))
    assert after.model.refinement.error == ("simulation" if taken else None)
    assert after.report.findings[-1] == note("fit.single_simulation", ratio=pytest.approx(part), taken=taken)


def two_tanks(seed, samples=400, dt=4.0):
    """Log of the lower one of two tanks, each of which drains slowly, with a slow unknown flow into the lower one."""
    generator, x, w, seen = np.random.default_rng(seed), np.array([0.5, 0.5]), 0.0, []
    u = np.repeat(generator.uniform(0, 1, samples // 20), 20)
    for held in u:
        seen.append(x[1])
        for _ in range(20):
            w += -w * dt / 20 / 40 + 0.05 * np.sqrt(2 * dt / 20 / 40) * generator.normal()
            x = x + dt / 20 * np.array([(held - x[0]) / 80, (x[0] - x[1] + w) / 60])
    y = np.full((samples + 1, 2), np.nan)
    y[:, 1] = np.array([*seen, x[1]]) + 0.01 * generator.normal(size=samples + 1)
    return Transitions.from_trajectory(torch.from_numpy(y), torch.from_numpy(u[:, None]), dt)


def test_the_better_one_of_two_fits_is_the_better_one_on_other_logs_too():
    """Which of the two is taken is told by the kept part; the oracle are logs of the same tanks that nothing saw."""
    signature, data = Signature(("upper", "lower"), ("m", "m"), ("u",), (1.0, 1.0)), two_tanks(1)
    place = torch.arange(len(data))
    source = Source(signature, data.select(place < 300), data.select(place >= 300), logged=True)
    initial = {"upper": {"u": 0.02, "upper": -0.02}, "lower": {"upper": 0.02, "lower": -0.02}}
    model = SindyModel(signature, ["1", "upper", "lower", "u"], Regression("bic"), Refinement("auto"), initial=initial)
    report = model.fit(source.training)
    assert report.in_pieces
    taken = module._whole(LogFit(model, source, report), forecast_errors(model, source.training, source.validation))[0]
    last = taken.report.findings[-1]
    assert taken.model is not model and last.code == "fit.single_simulation" and last.values["taken"]
    others = [two_tanks(seed) for seed in (11, 12, 13)]
    ours, theirs = (
        sum(float(forecast_errors(each, source.training, other).model[:, 1].log().mean()) for other in others)
        for each in (taken.model, model)
    )
    assert ours < theirs


def test_a_model_that_is_judged_over_shorter_horizons_is_compared_over_those_of_both():
    """One that runs away is judged over shorter horizons, too; there the other one has no errors."""
    signature = Signature(("q", "w"), ("rad", "rad/s"), ("u",), (1.0, 1.0))
    lost = replace(forecasts([0.1, 0.1], [9.0, 9.0], [9.0, 9.0]), horizons=(0.01, 0.1, 0.2))
    assert module._better(lost, forecasts([0.1, 0.1], [0.1, 0.1]), signature)
    assert not module._better(forecasts([0.1, 0.1], [0.1, 0.1]), lost, signature)
