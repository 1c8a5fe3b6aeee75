"""What is read off a plant's code computes what the plant does; what cannot be read is refused in one line."""

import copy
import pickle
import warnings

import pytest
import torch
from one_period import one_period
from torch.autograd import forward_ad

from dynasindy.systems import Pendulum, Tras, Trms33, Xi, integrate, rk4
from dynasindy.systems.base import Signature, System
from dynasindy.systems.compiler import compiler, load_library
from dynasindy.systems.machine import Machine
from dynasindy.systems.tracing import program
from dynasindy.systems.tras import TrasConstants

PLANTS = {"tras": Tras, "xi": Xi, "trms33": Trms33, "pendulum": Pendulum}
needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")


def drawn(system, rows, seed=0):
    generator = torch.Generator().manual_seed(seed)
    scale = torch.tensor(system.signature.x_scale, dtype=torch.float64)
    x = 3 * scale * torch.randn(rows, len(scale), generator=generator, dtype=torch.float64)
    return x, 2 * torch.rand(rows, system.signature.n_u, generator=generator, dtype=torch.float64) - 1


def steps(system, x, u, dt, substeps):
    """Integrate with torch alone."""
    touched, samples = torch.zeros(len(x), dtype=torch.bool), []
    for _ in range(substeps):
        x = rk4(system.forward, x, u, dt / substeps)
        if system.stops is not None:
            x, now = system.stops.apply(x)
            touched |= now
        samples.append(x)
    return torch.stack(samples, -2), touched


@needs_compiler
@pytest.mark.parametrize("name", PLANTS)
def test_machine_code_moves_a_plant_as_its_own_code_does(name):
    system = PLANTS[name]()
    x, u = drawn(system, 40)
    assert system.compiled(x, u) is not None
    samples, touched = integrate(system, x, u, 0.05, 5, system.stops)
    wanted, where = steps(system, x, u, 0.05, 5)
    torch.testing.assert_close(samples, wanted, rtol=1e-12, atol=1e-12)
    assert torch.equal(touched, where)
    assert name == "pendulum" or 3 < int(where.sum()) < 40
    single = integrate(system, x.float(), u.float(), 0.05, 5, system.stops)[0]
    scale = torch.tensor(system.signature.x_scale, dtype=torch.float64)
    torch.testing.assert_close(single / scale, wanted / scale, rtol=1e-4, atol=1e-5, check_dtype=False)
    assert torch.equal(integrate(system, x[7], u[7], 0.05, 5, system.stops)[0], samples[7])  # no batch at all


@needs_compiler
def test_constants_of_its_own_are_read_and_copies_move_alike():
    system = Tras(constants=TrasConstants(arm_a=0.2, friction_p=0.01, drag_a=(0.09, 0.08)))
    x, u = drawn(system, 5)
    samples = integrate(system, x, u, 0.05, 2)[0]
    free = Tras(1e9, 1e9, system.constants)
    torch.testing.assert_close(samples, steps(free, x, u, 0.05, 2)[0], rtol=1e-11, atol=1e-11)
    assert not torch.allclose(samples, integrate(Tras(), x, u, 0.05, 2)[0])
    for twin in (copy.deepcopy(system), pickle.loads(pickle.dumps(system))):
        assert torch.equal(integrate(twin, x, u, 0.05, 2)[0], samples)


def test_without_a_compiler_torch_moves_the_plant(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    system = Tras(azimuth_stop=5.4321, constants=TrasConstants(motor_a=37001.5))
    x, u = drawn(system, 3)
    assert system.compiled(x, u) is None
    torch.testing.assert_close(integrate(system, x, u, 0.05, 2, system.stops)[0], steps(system, x, u, 0.05, 2)[0])


@needs_compiler
def test_everything_that_can_be_read():
    def forward(x, u):
        a, b = x.unbind(-1)
        c = u[..., 0]
        one = torch.sin(a) * torch.cos(b) - torch.exp(-a.square()) + 2.5 / (1 + torch.square(c))
        two = (a > 0.5).to(x.dtype) * b.abs() - (b <= c).to(x.dtype) + (a < b).to(x.dtype) * (c >= 0).to(x.dtype)
        two = two + torch.tanh(3 * c) * torch.sqrt(1 + a * a) ** 3 - torch.sign(b) / 4 + 1e-3 * (1 - c) - (-b)
        return torch.stack((one, two), -1)

    class Plant(System):
        machine_code = True

        def forward(self, x, u):
            return forward(x, u)

    system = Plant(Signature(("a", "b"), ("rad", "rad"), ("u",), (0.5, 0.5)))
    x, u = drawn(system, 64)
    code = Machine(program(forward, 2, 1), torch.float64)
    wanted = steps(system, x, u, 0.1, 2)[0]
    torch.testing.assert_close(one_period(code, x, u, 0.1, 2)[0], wanted, rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(integrate(system, x, u, 0.1, 2)[0], wanted, rtol=1e-12, atol=1e-12)
    single = one_period(Machine(program(forward, 2, 1)), x.float(), u.float(), 0.1, 2)[0]
    torch.testing.assert_close(single.double(), wanted, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("forward", "words"),
    [
        (lambda x, u: x @ torch.eye(2), "cannot be read"),
        (lambda x, u: torch.stack([x[..., 0] if x[..., 0] > 0 else x[..., 1]] * 2, -1), "cannot be read"),
        (lambda x, u: torch.stack([x[..., 0] ** 0.5] * 2, -1), "0.5"),
        (lambda x, u: torch.stack([x[..., 0]] * 3, -1), "per state"),
        (lambda x, u: torch.stack([torch.erf(x[..., 0])] * 2, -1), "erf"),
        (lambda x, u: torch.stack([x[..., 0] * torch.ones(3)] * 2, -1), "cannot be read"),
        (lambda x, u: torch.stack(x.unbind(0), -1), "unbind"),
        (lambda x, u: torch.stack([c for a, b, c in [x.unbind(-1)]] * 2, -1), "cannot be read"),
        (lambda x, u: torch.stack([x[0]] * 2, -1), "select"),
        (lambda x, u: torch.stack([x[..., 0].cumsum(0)] * 2, -1), "cumsum"),
        (lambda x, u: torch.stack([x[..., 0].long().to(x.dtype)] * 2, -1), "cannot be read"),
        (lambda x, u: torch.stack([((x[..., 0] > 0) + (u[..., 0] > 0)).to(x.dtype)] * 2, -1), "cannot be read"),
    ],
)
def test_what_cannot_be_read_is_told(forward, words):
    with pytest.raises(TypeError, match=words):
        program(forward, 2, 1)


@needs_compiler
def test_a_plant_whose_numbers_are_set_anew_moves_by_them():
    system = Pendulum()
    x, u = drawn(system, 4)
    before = integrate(system, x, u, 0.1, 2)[0]
    system.damping_term *= 3
    after = integrate(system, x, u, 0.1, 2)[0]
    torch.testing.assert_close(after, steps(system, x, u, 0.1, 2)[0], rtol=1e-12, atol=1e-12)
    assert not torch.allclose(after, before)


@needs_compiler
def test_transforms_of_torch_are_left_to_torch():
    system = Pendulum()
    x, u = drawn(system, 4)

    def moved(x):
        return integrate(system, x, u[0], 0.1, 2)[0][-1]

    alone = torch.stack([moved(row) for row in x])
    torch.testing.assert_close(torch.func.vmap(moved)(x), alone, rtol=1e-12, atol=1e-12)
    whole = torch.func.jacrev(moved)(x[0])
    torch.testing.assert_close(torch.func.jacfwd(moved)(x[0]), whole)
    with forward_ad.dual_level():
        dual = moved(forward_ad.make_dual(x[0], torch.ones_like(x[0])))
        torch.testing.assert_close(forward_ad.unpack_dual(dual).tangent, whole.sum(-1))


@needs_compiler
def test_a_compiler_that_is_none_leaves_plants_to_torch(tmp_path, monkeypatch):
    stub = tmp_path / "cc"
    stub.write_text("#!/bin/sh\necho no developer tools were found >&2\nexit 1\n")
    stub.chmod(0o755)
    monkeypatch.setenv("CC", str(stub))
    system = Pendulum(mass=1.0625)
    system.damping_term, system.more = 0.123456, 0.0
    x, u = drawn(system, 3)
    load_library.cache_clear()
    with pytest.warns(UserWarning, match="slower"):
        samples = integrate(system, x, u, 0.1, 2)[0]
    assert torch.equal(samples, steps(system, x, u, 0.1, 2)[0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert system.compiled(x, u) is None  # and says so once
