"""What is found before a fit: wrong units first, then few rows, angles without sines, and long lists of functions."""

from dataclasses import replace
from functools import cache, partial

import pytest
import torch

from dynasindy.dyna.simulated import Simulated
from dynasindy.envs.rollout_data import record_plant
from dynasindy.excitation import Aprbs, Chirp
from dynasindy.findings import note, weak
from dynasindy.identification.before_fit import before_fit, lacking_rates, with_missing_rates
from dynasindy.identification.identify import LoggedData
from dynasindy.sindy import SindyModel
from dynasindy.systems import Pendulum

EXCITATION = partial(Chirp, duration=5.0)


@cache
def simulated():
    return Simulated(validation_seconds=2.0).load(Pendulum(), EXCITATION)


def log(path, heading, factors=(1.0, 1.0, 1.0), rows=400):
    """Write what a pendulum does under a chirp, its columns in other units, and return it as a source."""
    data = simulated().training
    columns = (data.x[:, 0] * factors[0], data.x[:, 1] * factors[1], data.u[:, 0] * factors[2])
    lines = [",".join(map(str, (k * data.dt, *(float(c[k]) for c in columns)))) for k in range(rows)]
    path.write_text("\n".join([heading, *lines]))
    return LoggedData(str(path)).load(None, EXCITATION)


def told(source, library="auto"):
    return [each for each in before_fit(SindyModel(source.signature, library), source) if each.code != "log.time"]


def test_a_log_with_an_angle_in_degrees_and_a_rate_in_rad_is_told(tmp_path):
    data = simulated().training
    lines = ["time,theta,Omega,u"]
    lines += [f"{k * data.dt},{data.x[k, 0] * 57.29578},{data.x[k, 1]},{data.u[k, 0]}" for k in range(len(data))]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    source = LoggedData(str(tmp_path / "log.csv")).load(Pendulum(), EXCITATION)
    model = SindyModel(source.signature, "auto")
    told = before_fit(model, source)[0]
    assert (told.code, told.severity) == ("log.rate_units", "weak") and told.values["rate"] == "Omega"
    assert told.values["factor"] == pytest.approx(57.3, rel=1e-3)
    assert not before_fit(SindyModel(simulated().signature, "auto"), simulated())


@pytest.mark.parametrize("library", ["auto", "auto_rig"])
def test_an_angle_in_degrees_is_told_the_map_that_reads_it_in_rad(tmp_path, library):
    """Degrees that a heading names are converted; these were asked for."""
    log(tmp_path / "log.csv", "time,theta [deg],Omega [deg/s],u", (57.29578, 57.29578, 1.0))
    kept = {"theta": {"name": "theta", "unit": "deg"}, "Omega": {"name": "Omega", "unit": "deg/s"}}
    source = LoggedData(str(tmp_path / "log.csv"), kept).load(None, EXCITATION)
    (found,) = told(source, library)
    assert found.code == "log.degrees" and (found.values["angle"], found.values["unit"]) == ("theta", "deg")
    read = LoggedData(str(tmp_path / "log.csv"), found.values["states"]).load(None, EXCITATION)
    assert read.signature.state_units == ("rad", "rad/s") and not told(read)
    assert float(read.training.x[:, 0].abs().max() / source.training.x[:, 0].abs().max()) == pytest.approx(0.01745329)
    assert not told(source, ["theta", "Omega", "u"])  # whoever names the functions has chosen
    # A rate that no column has is no column to be read: `plant.known` adds it.
    x = source.training.x.clone()
    x[:, 1] = torch.nan
    found = told(replace(source, training=replace(source.training, x=x)), library)[0]
    assert list(found.values["states"]) == ["theta"]


def test_a_rate_that_is_missing_is_told_once_and_not_once_it_is_given(tmp_path, write_log):
    """The pendulum's angle, read by an encoder alone."""
    data = record_plant(Pendulum(), Aprbs(1, 8.0, amplitude=0.4, seed=0).samples(0.01), 0.01)
    path = str(write_log(tmp_path / "log.csv", ["a [rad]", "u"], data.x[:, :1], data.u))
    source = LoggedData(path).load(None, EXCITATION)
    assert told(source) == [weak("fit.rates_missing", states=["a"], known={"a": "a_rate"})]
    known = LoggedData(path, known={"a": "a_rate"}).load(None, EXCITATION)
    found, rates, said = with_missing_rates(partial(SindyModel, library="auto"), source, None)
    assert rates == {"a": "a_rate"} and found.signature == known.signature
    assert said == [note("fit.rates_added", known={"a": "a_rate"})]
    for library, given in (("auto", {}), (["1", "a", "u"], None)):  # nobody wants it, or the functions are chosen
        assert with_missing_rates(partial(SindyModel, library=library), source, given) == (source, {}, [])
    model = SindyModel(known.signature, "auto", known={"a": "a_rate"})
    clock, unseen = before_fit(model, known)
    assert clock.code == "log.time" and clock.values["dt"] == pytest.approx(0.01)
    assert unseen == note("log.unmeasured", state="a_rate")
    assert lacking_rates(model, known) == {"a": "a_rate"}


def test_few_rows_are_told_with_what_was_left_out(tmp_path):
    heading = "time,theta [rad],Omega [rad/s],u"
    few = told(log(tmp_path / "log.csv", heading, rows=61), ["theta", "Omega", "u", "sin(theta)"])[0]
    assert few == weak("log.few_rows", rows=45, least=50)  # three quarters of 60
    enough = told(log(tmp_path / "log.csv", heading, rows=81), ["theta", "Omega", "u", "sin(theta)"])
    assert "log.few_rows" not in [each.code for each in enough]
    lines = (tmp_path / "log.csv").read_text().splitlines()
    (tmp_path / "log.csv").write_text("\n".join([*lines[:30], "0.3,,,", *lines[31:62]]))
    found = told(LoggedData(str(tmp_path / "log.csv")).load(None, EXCITATION), ["theta", "Omega", "u", "sin(theta)"])
    assert [each.code for each in found[:2]] == ["log.few_rows", "log.missing"] and found[1].values["rows"] == 1
