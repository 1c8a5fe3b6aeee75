"""Linear models and equilibria against published figures and scipy."""

import numpy as np
import pytest
import torch

from dynasindy.systems import Signature, System, Tras, Xi
from dynasindy.systems.equilibria import Equilibria, find_equilibria, modes

OUTPUTS = (0, 1)


def equilibria_of(system: System, targets: torch.Tensor) -> Equilibria:
    return find_equilibria(system, OUTPUTS[: targets.shape[-1]], targets, torch.zeros(system.signature.n_x), 0.05)


def linear_xi():
    found = equilibria_of(Xi(), torch.zeros(1, 2))
    return found.a[0], found.b[0]


def test_eigenvalues_of_xi_at_pitch_zero_are_those_known():
    eigenvalues = np.sort_complex(torch.linalg.eigvals(linear_xi()[0]).numpy())
    known = np.sort_complex([0, -10.06, -5.23, -1.42, -0.207 + 1.871j, -0.207 - 1.871j])
    np.testing.assert_allclose(eigenvalues, known, atol=0.005)


def test_a_plant_whose_only_state_is_held_rests_where_its_input_makes_up_for_its_loss():
    """x' = -2 x + 3 u rests at x with u = 2 x / 3."""

    class Box(System):
        def __init__(self):
            super().__init__(Signature(("x",), ("-",), ("u",), (1.0,)))

        def forward(self, x, u):
            return -2 * x + 3 * u

    found = equilibria_of(Box(), torch.tensor([[0.3]]))
    assert float(found.x) == pytest.approx(0.3) and float(found.u) == pytest.approx(0.2)


def test_equilibria_of_xi_are_those_known():
    known = {-0.5: (-0.157, -0.131), -0.25: (-0.139, 0.044), 0.0: (-0.122, 0.210), 0.4: (-0.100, 0.432)}
    reference = torch.tensor([[0.3, pitch] for pitch in known])
    found = equilibria_of(Xi(), reference)
    torch.testing.assert_close(found.u.float(), torch.tensor(list(known.values())), atol=1e-3, rtol=0)
    torch.testing.assert_close(found.x[:, :2], reference.double())


@pytest.mark.parametrize("system", [Tras(), Xi()])
def test_a_system_stays_at_its_equilibrium(system):
    found = equilibria_of(system, torch.rand(12, 2) - 0.5)
    assert found.x.shape == (12, 6)
    scale = torch.tensor(system.signature.x_scale)
    assert (system(found.x, found.u) / scale).abs().max() < 1e-8


def test_a_reference_that_is_no_number_has_no_equilibrium():
    found = equilibria_of(Tras(), torch.tensor([[0.0, float("nan")], [0.1, 0.0]]))
    assert found.targets.tolist() == [[pytest.approx(0.1), 0.0]] and len(found.unheld) == 1


def test_modes_of_a_difference_equation_are_logarithms_of_what_it_multiplies_by():
    """-0.6 every 0.1 s halves in turns of 0.2 s: log(0.6) / 0.1 + pi / 0.1 i; what is gone at once is gone fast."""
    a = torch.diag(torch.tensor([-1.6, -0.5, -1.0], dtype=torch.float64)) / 0.1
    found = modes(a, 0.1)
    assert complex(found[0]) == pytest.approx(complex(np.log(0.6), np.pi) / 0.1)
    assert complex(found[1]) == pytest.approx(np.log(0.5) / 0.1)
    assert float(found[2].real) == pytest.approx(np.log(1e-6) / 0.1)
    assert sorted(modes(a).real.tolist()) == pytest.approx([-16.0, -10.0, -5.0])
