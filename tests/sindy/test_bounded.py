"""A tank that settles stays near its log, one that nothing balances does not."""

import pytest
import torch
from alternating import Mapped

from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.prediction import stays_near
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("level", "hidden"), ("m", "m"), ("u", "w"), (1.0, 1.0))


def _model(drain: float, constant: float, second: float = 0.0) -> SindyModel:
    model = SindyModel(SIGNATURE, ["u", "level", "1", "w", "hidden"])
    model.set_coefficients(torch.tensor([[1.0, 0], [drain, 0], [constant, 0], [second, 0], [0, 1e-4]]).double())
    return model


@pytest.mark.parametrize(
    ("drain", "constant", "second", "near"),
    [
        (-1.0, 0.0, 0.0, True),  # settles at u, so between 0 and 2
        (-0.1, 0.0, 0.0, False),  # settles at 10 u, so at up to 20
        (0.0, -1.0, 0.0, False),  # loses 1 a second however little comes in
        (-1.0, 0.0, 9.0, False),  # a second input lifts it to 10
    ],
)
def test_a_level_is_where_its_balance_holds_it(drain, constant, second, near):
    inputs = torch.stack([torch.linspace(0, 2, 40), torch.linspace(0, 1, 40).flip(0)], -1).double()
    states = torch.stack([torch.linspace(0, 2, 41), torch.full((41,), torch.nan)], -1).double()
    data = Transitions.from_trajectory(states, inputs, 0.5)
    # What was not measured has no range, and its growth is no reason.
    assert stays_near(_model(drain, constant, second), data, torch.tensor([1.0, 1.0]).double()) is near


@pytest.mark.parametrize(("a", "dt", "near"), [(-0.6, 0.5, True), (-1.5, 0.5, False), (-1.5, 1.0, False)])
def test_a_difference_equation_stays_where_its_map_does(a, dt, near):
    """x[k+1] = a x[k] + u[k]: by -1.5 it grows from step to step, where x' = (-2.5 x + u) / 0.5 would settle."""
    states, inputs = torch.linspace(-1, 1, 41).double(), torch.linspace(-0.8, 0.8, 40).double()
    data = Transitions.from_trajectory(states.unsqueeze(-1), inputs.unsqueeze(-1), dt)
    assert stays_near(Mapped(a, 1.0), data, torch.tensor([0.5]).double()) is near
