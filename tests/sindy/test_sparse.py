"""Code of a sparse model is that of its equations as they are now."""

import copy
import pickle

import pytest
import torch
from torch import Tensor

from dynasindy.sindy import SindyModel
from dynasindy.sindy import model as sparse
from dynasindy.sindy.codegen import generate
from dynasindy.sindy.covariance import of_sums
from dynasindy.sindy.library import Library
from dynasindy.systems import Xi, integrate
from dynasindy.systems.compiler import compiler
from dynasindy.systems.transitions import Transitions


def drawn(rows=5):
    rng = torch.Generator().manual_seed(0)
    x = torch.randn(rows, 6, generator=rng, dtype=torch.float64) * torch.tensor(Xi().signature.x_scale).double()
    return x, 2 * torch.rand(rows, 2, generator=rng, dtype=torch.float64) - 1


def moved(seed):
    """Return where the plant is a hundredth of a second after some states."""
    rng = torch.Generator().manual_seed(seed)
    x = torch.randn(300, 6, generator=rng, dtype=torch.float64) * torch.tensor(Xi().signature.x_scale).double()
    u = 2 * torch.rand(300, 2, generator=rng, dtype=torch.float64) - 1
    return Transitions(x, u, integrate(Xi(), x, u, 0.01, 2)[0][:, -1], 0.01, torch.arange(300))


def model(factor=1.0, **given):
    found, (x, u) = SindyModel(Xi().signature, **given), drawn(400)
    found.fit_derivatives(x, u, Xi()(x, u))
    found.set_coefficients(factor * found.coefficients)
    return found


@pytest.mark.parametrize("machine_code", [False, True])
def test_a_model_moves_by_its_coefficients_as_they_are_now(machine_code):
    """The oracle is the library times the coefficients, integrated by torch."""
    found, (x, u) = model(machine_code=machine_code), drawn()
    assert (found.compiled(x, u) is None) == (not machine_code or compiler() is None)

    def _change(k):
        if k == 1:
            found.set_coefficients(2.0 * found.coefficients)
        elif k == 2:
            found.coefficients[0] = 0.5  # in place
        elif k == 3:
            found.load_state_dict(model(3.0).state_dict())

    for k in range(4):
        _change(k)
        wanted, _ = integrate(lambda x, u: found.library(x, u) @ found.coefficients, x, u, 0.05, 2)
        torch.testing.assert_close(integrate(found, x, u, 0.05, 2)[0], wanted, rtol=1e-9, atol=1e-12)
        torch.testing.assert_close(found(x, u), found.library(x, u) @ found.coefficients, rtol=1e-9, atol=1e-12)


def test_coefficients_that_are_not_finite_are_refused_by_all_code():
    found, (x, u) = model(), drawn()
    found.coefficients[2, 1] = torch.nan
    for _ in range(2):
        with pytest.raises(ValueError, match="finite"):
            found.compiled(x, u)
        with pytest.raises(ValueError, match="finite"):
            found(x, u)


def test_code_is_written_anew_only_for_new_coefficients(monkeypatch):
    found, (x, u), written = model(), drawn(), []
    monkeypatch.setattr(sparse, "generate", lambda *of: written.append(of) or generate(*of))
    for _ in range(3):
        found(x, u)
    assert len(written) == 1
    found.coefficients.fill_(0.5)
    found(x, u)
    found.set_coefficients(found.coefficients.clone())
    found(x, u)
    assert len(written) == 3


def test_a_model_goes_back_to_all_that_it_had_learnt():
    """The oracle is a copy of its state."""
    model, first, second = SindyModel(Xi().signature), moved(1), moved(2)
    model.fit(first)
    model.update(second)
    before, go_back = copy.deepcopy(model.state_dict()), model.kept()
    model.absorb(first)
    model.update(second)
    assert not torch.equal(model.coefficients, before["coefficients"])
    for _ in range(2):
        go_back()
        model.absorb(first)  # leaves what is gone back to as it is
        go_back()
    _same(model.state_dict(), before)


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


def test_a_model_of_a_users_class_goes_back_to_all_that_it_has_learnt():
    class Biased(SindyModel):
        def __init__(self):
            super().__init__(Xi().signature)
            self.register_buffer("bias", torch.zeros(6))

    model = Biased()
    model.fit(moved(1))
    before, go_back = copy.deepcopy(model.state_dict()), model.kept()
    model.update(moved(2))
    model.bias += 1.0
    go_back()
    assert not model.bias.any()
    _same(model.state_dict(), before)


def test_errors_that_are_told_later_are_those_of_the_fit():
    model, first, second = SindyModel(Xi().signature), moved(1), moved(2)
    model.fit(first)
    report = model.update(second)
    wanted = of_sums(model.coefficients, model.constraints.free, model.sums.copy())
    model.absorb(first)
    copied = pickle.loads(pickle.dumps(model))
    model.coefficients.mul_(2.0)
    for found in (model.covariance, report.covariance, copied.covariance):
        assert torch.equal(found.factor, wanted.factor)


def _same(found, wanted):
    assert type(found) is type(wanted)
    if isinstance(wanted, Tensor):
        assert torch.equal(found, wanted)
    elif isinstance(wanted, dict):
        assert found.keys() == wanted.keys()
        for key in wanted:
            _same(found[key], wanted[key])
    elif isinstance(wanted, (tuple, list)):
        assert len(found) == len(wanted)
        for one, other in zip(found, wanted, strict=True):
            _same(one, other)
    else:
        assert found == wanted
