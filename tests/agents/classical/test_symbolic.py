"""CasADi functions of systems against the systems themselves and autograd."""

import sys

import numpy as np
import pytest
import torch
from torch.autograd.functional import jacobian

from dynasindy.agents.classical import symbolic
from dynasindy.sindy import SindyModel
from dynasindy.systems import Pendulum, Tras, Trms33, Xi

casadi = pytest.importorskip("casadi")


def sparse(library):
    model = SindyModel(Tras().signature, library)
    rng = torch.Generator().manual_seed(1)
    table = torch.randn(model.coefficients.shape, generator=rng, dtype=torch.float64)
    model.set_coefficients(table * (torch.rand(table.shape, generator=rng) < 0.2))
    return model


@pytest.mark.parametrize(
    "system",
    [Tras(), Xi(), Trms33(), Pendulum(), sparse("rotor"), sparse("paper_equation")],
    ids=["tras", "xi", "trms33", "pendulum", "rotor model", "paper's model"],
)
def test_values_and_slopes_are_those_of_torch_on_either_side_of_every_branch(system):
    field = symbolic.vector_field(system)
    slope = field.jacobian()
    scale = torch.tensor(system.signature.x_scale, dtype=torch.float64)
    rng = torch.Generator().manual_seed(0)
    for _ in range(8):
        x = scale * (2 * torch.rand(len(scale), generator=rng, dtype=torch.float64) - 1)
        u = 2 * torch.rand(system.signature.n_u, generator=rng, dtype=torch.float64) - 1
        np.testing.assert_allclose(field(x.numpy(), u.numpy()).full()[:, 0], system(x, u).numpy(), rtol=1e-9, atol=1e-9)
        slopes = slope(x.numpy(), u.numpy(), 0)
        for mine, torchs in zip(slopes, jacobian(system, (x, u)), strict=True):
            np.testing.assert_allclose(mine.full(), torchs.numpy(), rtol=1e-9, atol=1e-9)


def test_tracing_leaves_the_system_as_it_was():
    model = sparse("rotor")
    x, u = torch.ones(3, 6, dtype=torch.float64), torch.ones(3, 2, dtype=torch.float64)
    before = model(x, u)
    symbolic.vector_field(model)
    torch.testing.assert_close(model(x, u), before, rtol=0, atol=0)


def test_an_operation_without_counterpart_is_named():
    class Strange(Xi):
        def forward(self, x, u):
            return torch.erf(super().forward(x, u))

    with pytest.raises(NotImplementedError, match=r"the system uses torch's 'erf'.*add a rule"):
        symbolic.vector_field(Strange())


def test_a_missing_package_costs_one_line_that_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(ModuleNotFoundError, match=r"MPC needs CasADi.*pip install 'dynasindy\[mpc\]'"):
        symbolic.vector_field(Xi())


def test_every_operation_is_that_of_torch():
    class Many(Pendulum):
        def forward(self, x, u):
            a, b = x.unbind(-1)
            w = u[..., 0]
            positive = a * a + 0.5
            terms = (
                torch.rsub(a, b, alpha=3.0) + torch.sub(a, w, alpha=2.0) + torch.add(b, w, alpha=-1.5),
                torch.addcmul(a, b, w, value=0.7) + torch.addcmul(b, a, w) + torch.neg(b) + (2.0 - a),
                torch.reciprocal(positive) + torch.square(b) + torch.pow(positive, 1.5) + a / positive,
                torch.sin(a) + torch.cos(b) + torch.tan(w) + torch.tanh(a) + torch.exp(b),
                torch.log(positive) + torch.sqrt(positive) + torch.sign(b) + torch.abs(a),
                torch.where((a > b) & ~(w >= 0) | (b <= w), a, 2 * b) + torch.minimum(a, b) + torch.maximum(a, w),
                torch.where(a < b, a, w) + torch.where(a == b, a, 3 * w) + torch.where(a != b, b, w),
                torch.atan2(a, b) + torch.zeros_like(a) + torch.ones_like(b),
            )
            columns = torch.cat([torch.stack(terms, -1), x[..., 1:], x.unsqueeze(-1).squeeze(-1)], -1)
            total = columns[..., 1:9:2].unbind(-1)[1]
            for weight, column in zip((1.0, 2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0), columns.unbind(-1)):
                total = total + weight * column
            return torch.stack((total, a), -1)

    system = Many()
    field, rng = symbolic.vector_field(system), torch.Generator().manual_seed(0)
    for _ in range(30):
        x, u = torch.randn(2, generator=rng).double(), torch.randn(1, generator=rng).double()
        np.testing.assert_allclose(field(x.numpy(), u.numpy()).full()[:, 0], system(x, u).numpy(), rtol=1e-9)
