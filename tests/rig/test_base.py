"""What a rig's plant looks like, and what is none."""

import pytest

from dynasindy.rig import Wiring
from dynasindy.systems import Pendulum

SIGNATURE = Pendulum().signature


def test_a_wiring_says_what_is_measured():
    assert Wiring(SIGNATURE, [1, 0], 0.02).seen == (True, False)


@pytest.mark.parametrize(("seen", "dt"), [((True,), 0.1), ((False, False), 0.1), ((True, True), 0.0)])
def test_what_is_no_wiring_is_refused(seen, dt):
    with pytest.raises(ValueError, match="bool"):
        Wiring(SIGNATURE, seen, dt)
