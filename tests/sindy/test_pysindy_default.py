"""The baseline is PySINDy's own fit."""

import numpy as np
import pysindy
import torch

from dynasindy.data.rollout_data import record_plant
from dynasindy.excitation import Multisine
from dynasindy.sindy import SindyModel
from dynasindy.sindy.pysindy_interchange import PySindyDefault
from dynasindy.systems import Pendulum


def test_it_has_the_coefficients_that_pysindy_has(tmp_path):
    data = record_plant(Pendulum(), Multisine(1, 5.0, amplitude=0.8, seed=1).samples(0.01), 0.01)
    model = PySindyDefault(Pendulum().signature)
    model.fit(data)
    theirs = pysindy.SINDy()
    theirs.fit(data.x.numpy(), t=0.01, u=data.u.numpy())
    expected = theirs.predict(data.x[:5].numpy(), u=data.u[:5].numpy())
    assert np.allclose(model(data.x[:5], data.u[:5]).numpy(), np.asarray(expected), rtol=1e-9, atol=1e-9)
    model.save(tmp_path / "model.json")
    assert SindyModel.load(tmp_path / "model.json").equations() == model.equations()


def test_segments_are_fitted_as_separate_trajectories():
    data = record_plant(Pendulum(), Multisine(1, 5.0, amplitude=0.8, seed=1).samples(0.01), 0.01)
    keep = torch.ones(len(data), dtype=torch.bool)
    keep[200:300] = False
    model = PySindyDefault(Pendulum().signature)
    model.fit(data.select(keep))
    assert len(model.equations()) == 2
