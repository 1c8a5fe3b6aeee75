"""A name that is nearly one that exists is answered with that."""

import pytest

from dynasindy.nearest import did_you_mean


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("thta", "; did you mean 'theta'?"),
        ("omega", "; did you mean 'Omega'?"),
        ("THETA_RATE", "; did you mean 'theta_rate'?"),
        ("pressure", ""),
        (1, ""),
    ],
)
def test_the_nearest_name_is_offered_and_none_that_is_far(name, hint):
    assert did_you_mean(name, ("theta", "Omega", "theta_rate")) == hint
