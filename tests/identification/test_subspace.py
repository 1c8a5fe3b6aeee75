"""Tests of linear models with states that no sensor sees."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.signal import cont2discrete

from dynasindy.identification.source import Source
from dynasindy.identification.subspace import subspace_models
from dynasindy.sindy import SindyModel
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

POLES = [-0.4, -1.5, -6.0]
"""Poles of a plant of third order with a gain of one, of which the output alone is measured [1/s]."""


def recorded(dt=0.1, seconds=60.0):
    """Record the plant under held random steps."""
    one, two, three = np.poly(POLES)[1:]
    a, b = np.array([[0, 1, 0], [0, 0, 1], [-three, -two, -one]]), np.array([[0], [0], [three]])
    a, b, *_ = cont2discrete((a, b, np.eye(3), np.zeros((3, 1))), dt)
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, round(seconds)), round(1 / dt))
    x = [np.zeros(3)]
    for held in u:
        x.append(a @ x[-1] + b[:, 0] * held)
    y = 20 + np.stack(x)[:, :1]
    return Transitions.from_trajectory(torch.from_numpy(y), torch.from_numpy(u).unsqueeze(-1), dt)


def test_states_that_no_sensor_sees_are_found_and_kept_in_a_file(tmp_path):
    data, signature = recorded(), Signature(("y",), ("K",), ("u",), (20.0,))
    model = subspace_models(SindyModel(signature, ["1", "y", "u"]), data, [2, 3], past=10)[3]
    rates = model.coefficients[1:4].mT.numpy()
    assert sorted(np.linalg.eigvals(rates).real) == pytest.approx(sorted(POLES), rel=0.01)
    rest = np.linalg.solve(rates, -(model.coefficients[0] + 0.5 * model.coefficients[4]).numpy())
    assert rest[0] == pytest.approx(20.5, abs=1e-3), "the gain is one, and the offset is the plant's"
    model.save(tmp_path / "model.json")
    read = Source(signature, data, data).with_states_of(SindyModel.load(tmp_path / "model.json"))
    assert read.signature.state_names == ("y", "hidden_1", "hidden_2")
    assert bool(read.training.x[:, 1:].isnan().all()) and torch.equal(read.training.x[:, 0], data.x[:, 0])


def test_what_a_recording_does_not_tell_has_no_model():
    data, signature = recorded(seconds=3.0), Signature(("y",), ("K",), ("u",), (20.0,))
    given = SindyModel(signature, ["1", "y", "u"])
    assert subspace_models(given, data, [2, 3], past=20) == {}
    lost = replace(data, x=torch.where(torch.arange(len(data)).unsqueeze(-1) % 5 == 0, torch.nan, data.x))
    assert subspace_models(given, lost, [2], past=5) == {}, "no row is complete"
