"""The instrument that measures standard errors: logs of its plants, and ratios that arithmetic tells."""

import numpy as np
import pytest
import torch
from benchmarks.certainty import Oscillator, oscillators, ratios, van_der_pol


def test_the_oscillator_is_pushed_and_lacks_what_its_library_has_not():
    plant = Oscillator(friction=0.6, cubic=3.0)
    x, u = torch.tensor([[0.5, 2.0]], dtype=torch.float64), torch.tensor([[1.0, 0.25]], dtype=torch.float64)
    assert plant(x, u)[0].tolist() == pytest.approx([2.0, -2 - 1.6 + 3 + 0.25 - 0.6 * np.tanh(16) - 0.375])


def test_logs_differ_in_inputs_and_pushes_which_the_library_does_not_see():
    library, guess, (one, other) = oscillators(Oscillator(), 0.6, 2)
    assert library.names == ("x", "v", "u") and one.u.shape == (1000, 1) and not torch.equal(one.u, other.u)
    assert guess[:, 1].tolist() == [-4, -0.8, 3] and not torch.equal(one.x, other.x)
    library, truth, logs = van_der_pol(3)
    assert len(logs) == 3 and int((truth != 0).sum()) == 5


@pytest.mark.parametrize(("push", "low", "high"), [(0.0, 0.5, 2), (0.6, 0.0, 0.3)])
def test_the_textbook_s_errors_hold_where_errors_are_white_and_only_there(push, low, high):
    library, guess, logs = oscillators(Oscillator(), push, 12)
    ours, textbook = ratios(library, guess, logs, True)
    assert len(ours) == 3  # the rate of x is v, and that is not fitted
    assert ((textbook > low) & (textbook < high)).all() and ((ours > 0.4) & (ours < 2.5)).all()
