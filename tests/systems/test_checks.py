import math
import warnings

import pytest
import torch
from plants import Plant

from dynasindy.systems import Signature, System
from dynasindy.systems.checks import require_plant

FREE = torch.tensor([[-math.inf], [math.inf]])


def level(outflow):
    """Return a tank whose outflow is a function of its level h, and which is filled by its input."""
    return Plant("h", lambda h, pump: [pump - outflow(h)], inputs="pump")


class Swing(System):
    """Two states, whose rates are what a function makes of states and inputs."""

    def __init__(self, field, n_x=2):
        names = tuple("abcd"[:n_x])
        super().__init__(Signature(names, ("1",) * n_x, ("u",), (1.0,) * n_x))
        self.field = field

    def forward(self, x, u):
        return self.field(x, u)


def at(*values):
    """Return what begins every episode in one state."""
    return lambda batch: torch.tensor(values).expand(*batch, -1)


@pytest.mark.parametrize(
    ("n_x", "field"),
    [
        (2, lambda x, u: torch.stack((x[1], u[..., 0] - x[0]), -1)),
        (2, lambda x, u: torch.stack((x[..., 1], u[0] - x[..., 0]), -1)),
        (3, lambda x, u: torch.stack((x[1], x[2], -x[0]), -1)),
        (3, lambda x, u: torch.stack((x[:, 1], x[:, 2], u[:, 0]), -1)),
    ],
)
def test_states_that_are_taken_from_the_batch_are_refused_whatever_their_number(n_x, field):
    with pytest.raises(ValueError, match="Swing") as error:
        require_plant(Swing(field, n_x), at(*[0.0] * n_x))
    assert "\n" not in str(error.value)


def test_a_row_that_takes_the_rates_of_another_is_refused():
    """With one state, `h[0]` fits into the shape that is wanted, with the value of the first row."""
    with pytest.raises(ValueError, match="places"):
        require_plant(level(lambda h: 0.2 * h[0]), at(0.5))
    with pytest.raises(ValueError, match="draw"):
        require_plant(level(lambda h: 0.2 * h + 0.01 * torch.randn_like(h)), at(0.5))
    require_plant(level(lambda h: 0.2 * h), at(0.5))


def test_where_rates_are_not_finite_is_said_when_the_plant_is_built():
    """The root of a negative level is no number, and the logarithm of zero is none either."""
    with pytest.warns(UserWarning, match="pump") as told:
        require_plant(level(torch.sqrt), at(0.5))
    (line,) = (str(each.message) for each in told)
    assert "plant.bounds" in line and "\n" not in line
    # One over h has a pole at zero only, in the middle of the range.
    with pytest.warns(UserWarning, match="places"):
        require_plant(level(torch.reciprocal), at(0.5))


def test_nothing_is_asked_of_a_plant_beyond_its_bounds():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        require_plant(level(torch.sqrt), at(0.5), torch.tensor([[0.0], [2.0]]))
        require_plant(level(torch.log), at(0.5), torch.tensor([[0.0], [2.0]]))  # its very end is no place
        require_plant(level(lambda h: h.clamp(min=0).sqrt()), at(0.5), FREE)
        require_plant(level(torch.sqrt), at(350.0), FREE)  # a temperature, which a range of 1 K never takes to zero
    with pytest.warns(UserWarning, match=r"-0\.98"):
        require_plant(level(torch.sqrt), at(0.5), FREE)


def test_a_plant_that_is_finite_nowhere_in_its_ranges_or_not_where_it_begins_is_refused():
    with pytest.raises(ValueError, match="constants"):
        require_plant(level(lambda h: (h - 3).sqrt()), at(4.0), torch.tensor([[0.0], [2.0]]))
    with pytest.raises(ValueError, match="begin"):
        require_plant(level(torch.sqrt), at(-0.5))
