"""The sparse model finds the published table, equals PySINDy, and survives a file or says what is damaged."""

import copy
import json
import math
import types
from typing import Any

import numpy as np
import pytest
import torch
from plants import held_motion
from published import TABLE
from torch import Tensor

from dynasindy.envs import Aprbs, Chirp, Excitation, Multisine
from dynasindy.findings import weak
from dynasindy.safe_io import DamagedFileError
from dynasindy.sindy import Library, Refinement, Regression, SindyModel, build_library
from dynasindy.sindy.covariance import Covariance
from dynasindy.sindy.fit_report import Refined
from dynasindy.sindy.library import CONSTANT, Constraints, parse, variable
from dynasindy.sindy.model import FORMAT
from dynasindy.systems import Diverged, Signature, System, Tras, Xi, integrate
from dynasindy.systems.transitions import Transitions

PUBLISHED = {(s, name): v for name, row in TABLE.items() for s, v in zip(Xi().signature.state_names, row) if v}
HOVER = (-0.11, 0.25)
KNOWN = {"alpha_a": "Omega_a", "alpha_p": "Omega_p"}


def _points(n: int = 2000) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    x = (2 * torch.rand(n, 6, generator=generator, dtype=torch.float64) - 1) * torch.tensor([1, 1, 1, 1, 3000, 2000.0])
    return x, 2 * torch.rand(n, 2, generator=generator, dtype=torch.float64) - 1


def _found(model: SindyModel) -> dict[tuple[str, str], float]:
    return {
        (state, name): float(model.coefficients[k, i])
        for i, state in enumerate(model.signature.state_names)
        for k, name in enumerate(model.library.names)
        if model.coefficients[k, i]
    }


def _recording(plant: System, excitation: Excitation) -> Transitions:
    u = excitation.samples(0.01)
    x, states = torch.zeros(1, 6, dtype=torch.float64), [torch.zeros(1, 6, dtype=torch.float64)]
    for k in range(len(u)):
        samples, touched = integrate(plant, x, u[k : k + 1], 0.01, 2, plant.stops)
        x = samples[:, -1]
        assert not bool(touched)
        states.append(x)
    return Transitions.from_trajectory(torch.cat(states), u, 0.01)


def test_exact_derivatives_give_the_published_table_and_nothing_else():
    x, u = _points()
    model = SindyModel(Xi().signature, "paper_table", Regression(threshold=0.9))
    model.fit_derivatives(x, u, Xi()(x, u))
    found = _found(model)
    assert found.keys() == PUBLISHED.keys()
    assert max(abs(found[k] / v - 1) for k, v in PUBLISHED.items()) < 1e-11


def test_the_rotor_model_predicts_the_first_principles_plant_over_an_episode():
    model = SindyModel(Tras().signature, "rotor", Regression("bic"), Refinement(), known=KNOWN)
    model.fit(_recording(Tras(), Chirp(2, duration=10.0, amplitude=(0.3, 0.2), offset=HOVER)))
    unseen = _recording(Tras(), Multisine(2, duration=10.0, amplitude=(0.3, 0.2), offset=(-0.11, 0.3), seed=0))
    with torch.no_grad():
        predicted = model.simulate(unseen.x[:1], unseen.u.unsqueeze(0), 0.01)[0, 1:]
    error = (predicted - unseen.x_next).square().mean(0).sqrt() / unseen.x_next.std(0)
    assert float(error.max()) < 0.02


@pytest.mark.parametrize("time", ["continuous", "discrete"])
@pytest.mark.parametrize("method", ["auto", "one_step", "trajectory", "integral"])
def test_a_log_of_nothing_but_noise_is_no_error(method, time):
    """White noise has no equation, so no function may stay through the refinement, whatever its method is."""
    generator, signature = torch.Generator().manual_seed(0), Signature(("a", "b"), ("-", "-"), ("u",), (1.0, 1.0))
    x = torch.randn(301, 2, generator=generator, dtype=torch.float64)
    u = torch.randn(300, 1, generator=generator, dtype=torch.float64)
    library = Library(signature, [CONSTANT, variable("u")])
    model = SindyModel(signature, library, refinement=Refinement(method=method), time=time)
    report = model.fit(Transitions(x[:-1], u, x[1:], 0.1, torch.zeros(300, dtype=torch.long)))
    assert weak("fit.dropped") in report.findings and model.covariance is None


@pytest.mark.parametrize("stage", ["regression", "refinement"])
def test_coefficients_that_are_not_finite_are_told_and_the_model_stays(stage):
    data = _recording(Xi(), Aprbs(2, duration=5.0, amplitude=(0.6, 0.45), offset=HOVER, seed=0))
    model = SindyModel(Xi().signature, "paper_table")
    model.fit(data)
    before = model.coefficients.clone()

    class Spoilt:
        def solve(self, *of):
            return before.clone().index_fill_(0, torch.tensor(3), torch.nan)

        def run(self, *of):
            return Refined(model.library, before.clone().index_fill_(0, torch.tensor(3), torch.inf))

    if stage == "regression":
        model.regression = Spoilt()
    else:
        model.refinement = Spoilt()
    told = f"the {stage} "
    with pytest.raises(Diverged, match=told):
        model.fit(data)
    assert torch.equal(model.coefficients, before)


def test_what_a_fit_changes_besides_coefficients_is_kept_in_its_state():
    signature = Signature(("v",), ("m/s",), ("u",), (1.0,))
    model, copy = (SindyModel(signature, ["v", "tanh(~3 v)", "u"]) for _ in range(2))
    model.set_coefficients(torch.tensor([[1.0], [2.0], [3.0]]))
    model.library, model.delay = model.library.with_shapes([7.0]), 0.03
    copy.load_state_dict(model.state_dict())
    x, u = torch.tensor([[0.2]]).double(), torch.tensor([[0.5]]).double()
    assert copy(x, u).item() == pytest.approx(0.2 + 2 * np.tanh(7 * 0.2) + 1.5)
    assert copy.delay == 0.03


class Beam(System):
    """A ball in a groove on a beam with a spring; no function of a general library is its centrifugal force, r w^2."""

    def __init__(self) -> None:
        signature = Signature(("r", "v", "a", "w"), ("m", "m/s", "rad", "rad/s"), ("u",), (0.3, 0.5, 0.5, 2.0))
        super().__init__(signature)

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        r, v, a, w = x.unbind(-1)
        pull = 0.7 * r * w**2 - 4.0 * r - 0.5 * v - 7.0 * torch.sin(a)
        return torch.stack((v, pull, w, 15.0 * u[..., 0] - 3.0 * w - 12.0 * a), -1)


@pytest.mark.parametrize("seed", range(3))
def test_of_functions_that_look_alike_those_stay_that_hold_farther_out(seed):
    plant, ends = Beam(), torch.tensor([0.3, 0.5, 1.2, 2.0], dtype=torch.float64)
    u = Aprbs(1, duration=10.0, amplitude=(0.4,), seed=seed).samples(0.02)
    states = [torch.zeros(1, 4).double()]
    for k in range(len(u)):
        states.append(integrate(plant, states[-1], u[k : k + 1], 0.02, 4)[0][:, -1])
    known = {"r": "v", "a": "w"}
    model = SindyModel(plant.signature, "auto", Regression("bic", tolerance=1e-4), Refinement("integral"), known)
    model.fit(Transitions.from_trajectory(torch.cat(states), u, 0.02))
    far = ends * (2 * torch.rand(500, 4, generator=torch.Generator().manual_seed(0)).double() - 1)
    wanted, still = plant(far, 0 * far[:, :1]), 0 * far[:, :1]
    assert (model(far, still) - wanted).norm(dim=0)[1] < 0.2 * wanted.norm(dim=0)[1]  # all functions: by far more
    assert int((model.coefficients[:, 1] != 0).sum()) <= 5


class Coupled(System):
    """Four masses in a ring, whose springs are pulled by the products of neighbours; the first one is pushed."""

    known = types.MappingProxyType({f"x{k}": f"v{k}" for k in range(4)})

    def __init__(self) -> None:
        names = tuple(f"{kind}{k}" for kind in "xv" for k in range(4))
        super().__init__(Signature(names, ("m",) * 4 + ("m/s",) * 4, ("f",), (1.0,) * 8))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        place, speed = x.split(4, -1)
        pull = torch.roll(place, 1, -1) - 4 * place - 0.5 * speed - 1.5 * place * torch.roll(place, -1, -1)
        return torch.cat([speed, pull + 6 * u * torch.eye(4, dtype=u.dtype)[0]], -1)

    def log(self, n: int) -> Transitions:
        """Return samples of a random excitation."""
        u = torch.from_numpy(np.random.default_rng(0).uniform(-1, 1, n // 8 + 1).repeat(8)[:n, None])
        states = [torch.zeros(1, 8).double()]
        for k in range(n):
            states.append(integrate(self, states[-1], u[k : k + 1], 0.1, 8)[0][:, -1])
        return Transitions.from_trajectory(torch.cat(states), u, 0.1)

    def model(self, **settings: Any) -> SindyModel:
        """Return a model with the 55 functions of a general library."""
        known = {} if settings.get("time") == "discrete" else self.known
        regression = Regression("bic", tolerance=1e-4)
        return SindyModel(self.signature, "polynomial", regression, Refinement("integral"), known, **settings)

    def missed(self, model: SindyModel) -> float:
        """Return the largest error of a rate of change, as a share of it."""
        x = 0.5 * torch.randn(200, 8, generator=torch.Generator().manual_seed(3)).double()
        wanted = self(x, 0 * x[:, :1])
        return float(((model(x, 0 * x[:, :1]) - wanted).norm(dim=0) / wanted.norm(dim=0)).max())


def test_a_library_that_is_cut_keeps_the_numbers_in_its_functions():
    # v' = 0.5 u - 8 tanh(30 v), in steps so short that no mean over one differs from what it is at its start.
    signature, n, dt = Signature(("v",), ("rad/s",), ("u",), (2.0,)), 20, 1e-7
    rng = torch.Generator().manual_seed(0)
    v = torch.linspace(-0.4, 0.4, n).double()[torch.randperm(n, generator=rng)].unsqueeze(-1)
    u = 0.8 * torch.cos(1.3 * torch.arange(n).double()).unsqueeze(-1)
    rate = 0.5 * u - 8 * torch.tanh(30 * v)
    model = SindyModel(signature, "auto_rig")
    model.library = model.library.with_shapes([30.0])
    report = model.fit(Transitions(v, u, v + dt * rate, dt, torch.arange(n)))
    assert [each.code for each in report.findings] == ["fit.library_cut"]
    torch.testing.assert_close(model(v, u), rate, rtol=1e-3, atol=1e-3)


def test_a_library_stays_whole_where_rates_were_not_measured():
    plant = Coupled()
    model, log = plant.model(), plant.log(100)
    log.x[:, 4:] = log.x_next[:, 4:] = torch.nan
    model.fit(log)
    assert len(model.library) == 55 and plant.missed(model) < 1e-3


def test_a_library_that_was_cut_is_cut_again_and_restored():
    plant = Coupled()
    model, other = plant.model(), plant.model()
    whole, first, go_back = model.library.names, copy.deepcopy(model.state_dict()), model.kept()
    model.fit(plant.log(120))
    once = model.library.names
    model.fit(plant.log(60))
    assert len(model.library) <= 12 < len(once) <= 24
    assert model.library.names == tuple(whole[k] for k in model.places)
    other.load_state_dict(model.state_dict())
    assert torch.equal(other.coefficients, model.coefficients) and other.library.names == model.library.names
    other.load_state_dict(first)
    go_back()
    for again in (other, model):
        assert again.library.names == whole and again.state_dict()["_extra_state"]["places"] == []
        again.fit(plant.log(120))
        assert again.library.names == once and plant.missed(again) < 1e-3


def test_functions_that_few_data_did_not_tell_come_in_with_more():
    plant = Coupled()
    model = plant.model()
    model.fit(plant.log(50))
    assert plant.missed(model) > 0.1
    report = model.fit(plant.log(500))
    assert plant.missed(model) < 1e-4 and "fit.library_cut" not in {each.code for each in report.findings}


def test_a_first_guess_keeps_a_library_whole_and_nothing_is_fitted_to_next_to_no_data():
    plant = Coupled()
    guess = {f"v{k}": {f"x{k}": -3.0, f"v{k}": -1.0} for k in range(4)}
    model = plant.model(initial=guess)
    model.fit(plant.log(90))
    assert len(model.library) == 55
    for few in (1, 8, 44):
        with pytest.raises(ValueError, match="45 or more"):
            plant.model().fit(plant.log(few))


PAIR = Signature(("x", "v"), ("m", "m/s"), ("u",), (1.0, 1.0))


def _oscillator(seed: int, noise: float = 0.01) -> Transitions:
    """x' = v, v' = -4 x - v + 3 u in exact steps of 0.05 s, with white noise in both states."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1, 1, 40).repeat(10)
    x = held_motion([[0.0, 1], [-4, -1]], [[0.0], [3]], [0, 0], u, 0.05)
    seen = x + noise * rng.normal(size=x.shape)
    return Transitions.from_trajectory(torch.from_numpy(seen), torch.from_numpy(u)[:, None], 0.05)


@pytest.mark.parametrize("method", ["integral", "one_step", "trajectory"])
def test_a_fit_knows_its_errors_and_keeps_them_with_the_model(tmp_path, method):
    model = SindyModel(PAIR, ["x", "v", "u"], Regression("bic"), Refinement(method), known={"x": "v"})
    assert model.covariance is None
    report = model.fit(_oscillator(0))
    known = model.covariance
    assert (known.features.tolist(), known.states.tolist()) == ([0, 1, 2], [1, 1, 1])  # x' = v was given
    assert report.covariance is known and "(standard errors)" in report.to_text()
    model.save(tmp_path / "model.json")
    kept = json.loads(json.dumps(model.record()))
    for again in (SindyModel.load(tmp_path / "model.json"), SindyModel.of_record(kept, "here")):
        read = again.covariance.factor
        np.testing.assert_allclose(read @ read.mT, known.factor @ known.factor.mT, rtol=1e-9)
        assert torch.equal(again.coefficients, model.coefficients)
    restored = SindyModel(PAIR, ["x", "v", "u"])
    restored.load_state_dict(model.state_dict())
    assert torch.equal(restored.covariance.factor, known.factor)
    model.set_coefficients(2 * model.coefficients)
    assert model.covariance is None  # they are others, of which nothing is known
    restored.load_state_dict(model.state_dict())
    assert restored.covariance is None


def drawn(rows=5):
    rng = torch.Generator().manual_seed(0)
    x = torch.randn(rows, 6, generator=rng, dtype=torch.float64) * torch.tensor(Xi().signature.x_scale).double()
    return x, 2 * torch.rand(rows, 2, generator=rng, dtype=torch.float64) - 1


def model(factor=1.0, **given):
    found, (x, u) = SindyModel(Xi().signature, **given), drawn(400)
    found.fit_derivatives(x, u, Xi()(x, u))
    found.set_coefficients(factor * found.coefficients)
    return found


@pytest.mark.parametrize("machine_code", [False, True])
def test_a_model_moves_by_its_library_as_it_is_now(machine_code):
    """Of a difference equation a period of one step is a product, of a differential equation it is none."""
    found, (x, u) = model(machine_code=machine_code), drawn()
    for step in (None, 0.05, None):
        found.library = found.library.with_step(step)
        rates = found.library(x, u) @ found.coefficients
        ends = integrate(found, x, u, 0.05, 1)[0][:, 0]
        assert torch.allclose(ends, x + 0.05 * rates, rtol=1e-12, atol=1e-13) == (step is not None)
    other = Library(found.signature, reversed(found.library.features))
    found.library = other
    torch.testing.assert_close(found(x, u), other(x, u) @ found.coefficients, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("rate", "most"), [(1.0, 1), (3.0, 3), (9.0, 9)])
def test_its_steps_fit_the_fastest_motion_anywhere_in_its_ranges(rate, most):
    """x' = -c (x^2 + 4 x) is fastest at the upper end of its range of 2, with 8 c; a step is .3 of that time."""
    signature = Signature(("x",), ("m",), ("u",), (2.0,))
    found = SindyModel(signature, ["x", "x^2"])
    found.set_coefficients(-rate * 0.3 / 8 * torch.tensor([[4.0], [1.0]], dtype=torch.float64))
    # The fastest of 64 places at random comes near to the end, not to it.
    assert 0.85 * most <= found.substeps(1.0) <= most
    assert found.substeps(0.1) == 1


def test_its_steps_fit_dry_friction_which_is_steep_at_rest_alone():
    """v' = -tanh(1000 v) / 1000 slows down at 1 per second at rest, and hardly anywhere else in its range."""
    found = SindyModel(Signature(("p", "v"), ("m", "m/s"), ("u",), (1.0, 1.0)), ["v", "tanh(1000 v)"])
    found.set_coefficients(torch.tensor([[1.0, 0.0], [0.0, -1e-3]], dtype=torch.float64))
    assert found.substeps(0.9) == 3


@pytest.mark.parametrize("machine_code", [False, True])
@pytest.mark.parametrize("moving", [False, True])
def test_many_trajectories_are_those_that_each_start_has_alone(machine_code, moving):
    """Twelve at once, in a batch of two dimensions, beside one without any; by a plain loop over periods, too."""
    found, ((x, _), (_, u), (_, end)) = model(machine_code=machine_code), (drawn(12), drawn(60), drawn(120))
    u, end = (part[-60:].reshape(12, 5, -1) for part in (u, end))
    end = end if moving else None
    shaped = [None if part is None else part.unflatten(0, (3, 4)) for part in (x, u, end)]
    whole = found.simulate(shaped[0], shaped[1], 0.04, 2, shaped[2]).flatten(0, 1)
    for k in range(12):
        alone = found.simulate(x[k], u[k], 0.04, 2, None if end is None else end[k])
        torch.testing.assert_close(whole[k], alone, rtol=1e-10, atol=1e-12)
    same = found.simulate(x, u[0], 0.04, 2, None if end is None else end[0])
    torch.testing.assert_close(same[0], whole[0], rtol=1e-10, atol=1e-12)  # all under the inputs of the first
    if not moving:
        for t in range(5):
            ends = integrate(found, whole[:, t], u[:, t], 0.04, 2)[0][:, -1]
            torch.testing.assert_close(whole[:, t + 1], ends, rtol=1e-10, atol=1e-12)


def test_trajectories_of_a_model_have_derivatives_and_are_those_of_its_own_rates():
    """x' = -2 x from x0 is x0 exp(-2 t), whose derivative by x0 is exp(-2 t); twice the rates, x0 exp(-4 t)."""

    class Faster(SindyModel):
        def forward(self, x, u):
            return 2 * super().forward(x, u)

    signature, u = Signature(("x",), ("-",), ("u",), (1.0,)), torch.zeros(10, 1, dtype=torch.float64)
    x0 = torch.tensor([1.5], dtype=torch.float64, requires_grad=True)
    for kind, rate in ((SindyModel, 2.0), (Faster, 4.0)):
        model = kind(signature, ["x"])
        model.set_coefficients(torch.tensor([[-2.0]], dtype=torch.float64))
        end = model.simulate(x0, u, 0.1, 4)[-1]
        assert end.item() == pytest.approx(1.5 * math.exp(-rate), rel=1e-5)
        assert torch.autograd.grad(end.sum(), x0)[0].item() == pytest.approx(math.exp(-rate), rel=1e-5)
    with torch.no_grad():
        assert model.simulate(x0, u, 0.1, 4)[-1].item() == pytest.approx(1.5 * math.exp(-4.0), rel=1e-5)


def coefficients(library: Library) -> torch.Tensor:
    generator = np.random.default_rng(0)
    size = 10.0 ** generator.uniform(-12, 12, (len(library), 6))
    return torch.from_numpy(np.where(generator.random(size.shape) < 0.3, size * generator.normal(size=size.shape), 0))


def save(library: Library, xi: torch.Tensor, path, **more) -> None:
    model = SindyModel(library.signature, library)
    model.set_coefficients(xi)
    for name, value in more.items():
        setattr(model, name, value)
    model.save(path)


@pytest.fixture
def written(tmp_path):
    library = build_library("paper_table", Xi().signature)
    save(library, coefficients(library), tmp_path / "model.json")
    return tmp_path / "model.json"


def test_a_file_can_be_read_by_a_person(written):
    data = json.loads(written.read_text())
    model = SindyModel.load(written)
    library, xi = model.library, model.coefficients
    assert data["format"] == FORMAT
    assert [line.partition("'")[0] for line in data["equations"]] == list(library.signature.state_names)
    assert data["signature"]["input_names"] == ["u_a", "u_p"]
    numbers = {(s, n): v for s, row in data["coefficients"].items() for n, v in row.items()}
    places = [(i, k) for i in range(6) for k in range(27) if xi[k, i]]
    states = library.signature.state_names
    assert numbers == {(states[i], library.names[k]): float(xi[k, i]) for i, k in places} and len(places) > 20


CALL = "__import__('os').system('touch canary')"


def name_state(name):
    def change(data):
        old = data["signature"]["state_names"][0]
        data["signature"]["state_names"][0] = name
        data["coefficients"][name] = data["coefficients"].pop(old)
        for factors in data["library"].values():
            for factor in factors:
                factor[0] = [name if variable == old else variable for variable in factor[0]]

    return change


def put(value, *path):
    def change(data):
        for step in path[:-1]:
            data = data[step]
        data[path[-1]] = value

    return change


HOSTILE = {
    "state with code": name_state(CALL),
    "state of two lines": name_state("a\nimport os"),
    "state that is a number": name_state("1"),
    "long state": name_state("x" * 1000),
    "too many states": put([f"s{k}" for k in range(100_000)], "signature", "state_names"),
    "unit with mathematics": put("$\\frac{", "signature", "state_units", 0),
    "range": put(float("inf"), "signature", "x_scale", 0),
    "function with code": put([[["u_p"], CALL, 1, 1.0]], "library", "u_p"),
    "two arguments of sin": put([[["u_p", "u_a"], "sin", 1, 1.0]], "library", "u_p"),
    "no argument": put([[[], "sin", 1, 1.0]], "library", "u_p"),
    "another variable": put([[["x'); import os; ('"], "sin", 1, 1.0]], "library", "u_p"),
    "power": put([[["u_p"], "id", 10**9, 1.0]], "library", "u_p"),
    "frequency": put([[["u_p"], "sin", 1, float("nan")]], "library", "u_p"),
    "first guess": put([[["u_p"], "tanh", 1, 1.0, float("inf")]], "library", "u_p"),
    "infinite coefficient": put(float("inf"), "coefficients", "omega_p", "u_p"),
    "word for a coefficient": put("1.0", "coefficients", "omega_p", "u_p"),
    "empty library": put({}, "library"),
    "many functions": put({str(k): [[["u_p"], "sin", 1, k + 0.5]] for k in range(20_000)}, "library"),
    "constraints": put({"alpha_a": {"free": [], "given": {"u_p": float("nan")}}}, "constraints"),
    "no row of a state": lambda data: data["coefficients"].pop("omega_p"),
    "negative delay": put(-0.01, "delay"),
    "delay that is no number": put(True, "delay"),
    "step that is no number": put(True, "step"),
    "settings of a fit": put({"method": CALL}, "refinement"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_model_of_a_stranger_is_numbers_and_registered_names_or_is_refused(written, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = json.loads(written.read_text())
    HOSTILE[name](data)
    written.write_text(json.dumps(data))
    with pytest.raises(ValueError) as error:  # noqa: PT011  the words differ from case to case
        SindyModel.load(written)
    assert "\n" not in str(error.value) and len(str(error.value)) < 2000
    assert not (tmp_path / "canary").exists()


def test_fitted_numbers_and_the_delay_come_back_to_the_last_digit(tmp_path):
    words = ["tanh(~7 Omega_a)", "Omega_p^2 per_cos2(~3 alpha_p)", "root(~0.1 alpha_a)", "tanh(7 Omega_a)"]
    library = Library(Xi().signature, map(parse, words)).with_shapes([5 + 1 / 3, 10 / 3, np.pi / 30])
    save(library, coefficients(library), tmp_path / "model.json", delay=0.1 / 3, process_noise=0.2 / 3)
    model = SindyModel.load(tmp_path / "model.json")
    again, delay = model.library, model.delay
    assert again.features == library.features and (delay, model.process_noise) == (0.1 / 3, 0.2 / 3)
    numbers = [(shape.frequency, shape.fitted) for shape in again.shapes]
    assert numbers == [(5 + 1 / 3, 7.0), (10 / 3, 3.0), (np.pi / 30, 0.1)]
    save(library, coefficients(library), tmp_path / "model.json")
    assert SindyModel.load(tmp_path / "model.json").delay == 0.0 and "delay" not in json.loads(
        (tmp_path / "model.json").read_text()
    )


def test_what_is_known_of_the_equations_comes_back(tmp_path):
    library = build_library("rotor", Tras().signature)
    constraints = Constraints.build(library, {"alpha_a": "Omega_a"}, {"omega_p": ["u_p"]}, {"Omega_p": {"u_a": -0.3}})
    save(library, coefficients(library), tmp_path / "model.json", constraints=constraints)
    back = SindyModel.load(tmp_path / "model.json").constraints
    assert torch.equal(back.free, constraints.free) and torch.equal(back.offset, constraints.offset)


def known_coefficients(columns: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(3)
    factor = rng.normal(size=(4, columns)) * np.array([[1e-9], [3.0], [1e6], [0.02]])
    return torch.tensor([2, 5, 2, 7]), torch.tensor([0, 0, 3, 3]), torch.from_numpy(factor)


@pytest.mark.parametrize("columns", [15, 2])
def test_the_covariance_of_coefficients_survives_its_file(tmp_path, columns):
    library, known = build_library("paper_table", Xi().signature), known_coefficients(columns)
    save(library, torch.ones(27, 6, dtype=torch.float64), tmp_path / "model.json", covariance=Covariance(*known))
    features, states, factor = SindyModel.load(tmp_path / "model.json").covariance
    assert torch.equal(features, known[0]) and torch.equal(states, known[1])
    size = known[2].norm(dim=-1)
    wanted = known[2] @ known[2].mT / size / size.unsqueeze(-1)
    np.testing.assert_allclose(factor @ factor.mT / size / size.unsqueeze(-1), wanted, atol=1e-13)
    told = json.loads((tmp_path / "model.json").read_text())["uncertainty"]["standard_errors"]
    assert told["alpha_a"][library.names[5]] == pytest.approx(float(size[1])) and told["alpha_p"] == {}


@pytest.mark.parametrize(
    "spoilt",
    [
        {"standard_errors": {}},
        {"standard_errors": {"alpha_a": {"1": -1.0}}, "correlation_factor": {"alpha_a": {"1": "1"}}},
        {"standard_errors": {"alpha_a": {"1": 1.0}}, "correlation_factor": {"alpha_a": {"1": ""}}},
        {"standard_errors": {"alpha_a": {"1": 1.0}}, "correlation_factor": {"alpha_a": {"1": "1 nan"}}},
        {"standard_errors": {"alpha_a": {"1": 1.0}}, "correlation_factor": {"alpha_a": {"1": "one"}}},
        [1.0],
    ],
)
def test_a_covariance_that_is_damaged_is_refused(written, spoilt):
    data = json.loads(written.read_text())
    if isinstance(spoilt, dict):
        spoilt = {what: {s: {} for s in data["coefficients"]} | words for what, words in spoilt.items()}
    written.write_text(json.dumps({**data, "uncertainty": spoilt}))
    with pytest.raises(DamagedFileError):
        SindyModel.load(written)
