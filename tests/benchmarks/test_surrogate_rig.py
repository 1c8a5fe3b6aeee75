"""The stand-in's log is one that a user could have written."""

import math

import pytest
import torch
from benchmarks.surrogate_rig import Rig

from dynasindy.systems import Tras


def test_cable_and_dry_friction_push_against_the_motion_and_motors_are_stronger():
    rig, x = Rig(), torch.tensor([0.4, 0.3, 0.5, -0.5, 0.0, 0.0], dtype=torch.float64)
    manual, u = Tras(constants=rig.constants), torch.tensor([0.2, 0.3], dtype=torch.float64)
    push = rig(x, u) - manual(x, u)
    j_c, j_1 = rig.constants.inertia_a
    inertia = j_c * math.cos(0.3) ** 2 + j_1
    # At 0.5 rad/s dry friction is full; the cable pulls back to its rest.
    assert float(push[2]) == pytest.approx((-0.006 * (0.4 - 0.15) - 0.0012) / inertia, rel=1e-6)
    assert float(push[3]) == pytest.approx(0.0012 / rig.constants.inertia_p, rel=1e-6)
    assert push[[0, 1, 4, 5]].tolist() == [0, 0, 0, 0]
    assert float(rig(torch.zeros(6), torch.tensor([0.0, 1.0]))[5]) == pytest.approx(9660.0)
