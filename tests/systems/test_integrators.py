import pytest
import torch

from dynasindy.systems import (
    Pendulum,
    Signature,
    Stops,
    System,
    Tras,
    integrate,
    moved,
    simulate,
    steps_needed,
)


def test_a_stop_touched_only_on_the_way_is_reported_and_every_sample_is_held():
    """Thrown up to the stop at 1, pulled back: it touches in the second of four sub-steps and leaves again."""
    stops = Stops((0,), (1,), (-9.0,), (1.0,))
    x, u = torch.tensor([0.5, 4.0], dtype=torch.float64), torch.tensor([-8.0], dtype=torch.float64)
    field = lambda x, u: torch.stack((x[..., 1], u[..., 0]), -1)  # noqa: E731
    samples, touched = integrate(field, x, u, 0.8, 4, stops)
    assert bool(touched)
    # 0.2 s: 0.5 + 0.8 - 0.16 = 1.14 is held at 1, rate 4 - 1.6 = 2.4 is zeroed; then 1 - 4 t^2 from rest.
    expected = torch.tensor([[1.0, 0.0], [0.84, -1.6], [0.36, -3.2], [-0.44, -4.8]], dtype=torch.float64)
    torch.testing.assert_close(samples, expected)
    beside = integrate(field, torch.stack([x, 0 * x]), torch.stack([u, 0 * u]), 0.8, 4, stops)[1]
    assert beside.tolist() == [True, False]


class Doubling(System):
    """x[k+1] = 2 x[k] + 0.5 u[k], every 0.1 s, as rates of change."""

    step = 0.1
    machine_code = True

    def forward(self, x, u):
        (position,), (push,) = x.unbind(-1), u.unbind(-1)
        return torch.stack((10.0 * position + 5.0 * push,), -1)


DOUBLING = Doubling(Signature(("x",), ("-",), ("u",), (1.0,)))


@pytest.mark.parametrize("machine_code", [True, False])
@pytest.mark.parametrize("substeps", [1, 4])
def test_a_difference_equation_is_moved_by_its_own_steps(machine_code, substeps):
    """From 1 under 2 it goes to 3, 7 and 15; within a control period there is nothing but its end."""
    x, u = torch.ones(2, 1, dtype=torch.float64), torch.full((2, 1), 2.0, dtype=torch.float64)
    DOUBLING.machine_code = machine_code
    for periods, end in ((1, 3.0), (3, 15.0)):
        samples, touched = integrate(DOUBLING, x, u, 0.1 * periods, substeps)
        assert samples.shape == (2, substeps, 1) and not bool(touched.any())
        torch.testing.assert_close(samples, torch.full_like(samples, end))
        torch.testing.assert_close(moved(DOUBLING, x, u, 0.1 * periods, substeps), torch.full_like(x, end))
    with pytest.raises(ValueError, match=r"0.25"):
        integrate(DOUBLING, x, u, 0.25, substeps)
    assert steps_needed(DOUBLING, x, u, 0.1, 1) == (1, 0.0)


def test_a_stop_holds_a_difference_equation_after_each_of_its_steps():
    """From 1 under 2 it would go to 3 and 7; held at 2.5 after the first step, it is at 2.5 after the second too."""
    one = torch.ones(1, 1, dtype=torch.float64)
    samples, touched = integrate(DOUBLING, one, 2 * one, 0.2, 1, Stops((0,), (0,), (-2.5,), (2.5,)))
    assert bool(touched.all()) and float(samples.abs().max()) <= 2.5


class Slow(Pendulum):
    """A pendulum whose class does not say that it has machine code."""


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("make", "n_u"), [(Pendulum, 1), (Slow, 1), (Tras, 2)])
def test_a_flight_is_its_periods_one_by_one(make, n_u, dtype):
    system, rng = make(), torch.Generator().manual_seed(2)
    stops = Stops((0,), (1,), (-0.02,), (0.02,))
    x = 0.02 * torch.randn(5, system.signature.n_x, generator=rng).to(dtype)
    u = 2 * torch.rand(30, 5, n_u, generator=rng).to(dtype) - 1
    samples, touched = simulate(system, x, u, 0.05, 3, stops)
    assert samples.shape == (30, 5, 3, system.signature.n_x)
    for held, course, hit in zip(u, samples, touched, strict=True):
        wanted, stopped = integrate(system, x, held, 0.05, 3, stops)
        assert torch.equal(course, wanted) and torch.equal(hit, stopped)
        x = wanted[:, -1]
    assert touched.any() and not touched.all()


def test_a_flight_under_gradients_has_them():
    system = Pendulum()
    u = torch.zeros(4, 1, 1, requires_grad=True)
    samples, _ = simulate(system, torch.zeros(1, system.signature.n_x), u, 0.05, 2)
    samples[-1, 0, -1, 0].backward()
    assert u.grad is not None and bool((u.grad != 0).all())
