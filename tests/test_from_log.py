"""A controller from a log: which model is taken, what is judged, and what the figures and the table say of it."""

from dataclasses import replace

import pytest
import torch

from dynasindy.dyna.simulated import record_plant
from dynasindy.envs import Multisine
from dynasindy.findings import note
from dynasindy.identification.source import Source
from dynasindy.sindy import Regression, SindyModel
from dynasindy.systems import Pendulum, Signature
from dynasindy.workbench import model_of

LIBRARY = ["1", "u", "Omega", "sin(theta)"]


def build(signature):
    return SindyModel(signature, LIBRARY, Regression("bic"), known={"theta": "Omega"})


@pytest.fixture(scope="module")
def source():
    data = record_plant(Pendulum(), Multisine(1, duration=6, dt=0.05, amplitude=[0.6], seed=0).samples(0.01), 0.01)
    place = torch.arange(len(data))
    findings = (note("log.gaps", count=2),)
    return Source(Pendulum().signature, data.select(place < 400), data.select(place >= 400), findings)


def test_the_fit_is_said_with_the_findings_of_the_log(source, capsys):
    model = model_of(source, build)
    said = capsys.readouterr().out
    assert "fit of 400 transitions" in said and f"note: {source.findings[0]}" in said
    assert model.equations()[1].startswith("Omega' = ")


def test_units_that_do_not_fit_are_said_before_the_fit(source, capsys):
    degrees, data = torch.tensor([57.29578, 1.0]), source.training
    wrong = replace(data, x=data.x * degrees, x_next=data.x_next * degrees)
    model_of(replace(source, training=wrong), build)
    said = capsys.readouterr().out
    assert "warning: Omega" in said and "57.3 times Omega" in said
    model_of(source, build)
    assert "warning" not in capsys.readouterr().out


def test_a_file_is_taken_if_it_is_of_the_plant(source, tmp_path):
    build(source.signature).save(tmp_path / "model.json")
    assert model_of(source, build, tmp_path / "model.json").library.names == tuple(LIBRARY)
    other = replace(source, signature=Signature(("level", "flow"), ("m", "m/s"), ("u",), (1.0, 1.0)))
    with pytest.raises(ValueError, match="flow"):
        model_of(other, build, tmp_path / "model.json")


def test_a_model_of_other_volts_is_refused(source, tmp_path):
    """What is 1 to the model has to be 1 in the log."""
    volts = replace(source.signature, input_ends=((-12, 12),))
    build(volts).save(tmp_path / "model.json")
    assert model_of(replace(source, signature=volts), build, tmp_path / "model.json").signature == volts
    with pytest.raises(ValueError, match="ends"):
        model_of(source, build, tmp_path / "model.json")
