"""What is said before a fit: wrong units first, then few rows, angles without sines, and long lists of functions."""

import shlex
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch
import yaml

from dynasindy.data.rollout_data import record_plant
from dynasindy.dyna.simulated import Simulated
from dynasindy.evaluation.before_fit import PLANTS, before_fit, rates_lacking, with_missing_rates, wrong_units
from dynasindy.evaluation.identification import LoggedData
from dynasindy.excitation import Aprbs, Chirp
from dynasindy.sindy import SindyModel
from dynasindy.systems import Pendulum, Tras

EXCITATION = partial(Chirp, duration=5.0)


def log(path, heading, factors=(1.0, 1.0, 1.0), rows=400):
    """Write what a pendulum does under a chirp, its columns in other units, and return it as a source."""
    data = Simulated().load(Pendulum(), EXCITATION).training
    columns = (data.x[:, 0] * factors[0], data.x[:, 1] * factors[1], data.u[:, 0] * factors[2])
    lines = [",".join(map(str, (k * data.dt, *(float(c[k]) for c in columns)))) for k in range(rows)]
    path.write_text("\n".join([heading, *lines]))
    return LoggedData(str(path)).load(None, EXCITATION)


def told(source, library="auto"):
    lines = before_fit(SindyModel(source.signature, library), source).lines
    return [line for line in lines if not line.startswith("note: time is the column")]


def test_a_log_with_an_angle_in_degrees_and_a_rate_in_rad_is_told(tmp_path):
    data = Simulated().load(Pendulum(), EXCITATION).training
    lines = ["time,theta,Omega,u"]
    lines += [f"{k * data.dt},{data.x[k, 0] * 57.29578},{data.x[k, 1]},{data.u[k, 0]}" for k in range(len(data))]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    source = LoggedData(str(tmp_path / "log.csv")).load(Pendulum(), EXCITATION)
    model = SindyModel(source.signature, "auto")
    (told,) = wrong_units(model, source)
    assert "warning: Omega" in told and "57.3 times Omega" in told
    assert before_fit(model, source).lines[0] == told
    exact = Simulated().load(Pendulum(), EXCITATION)
    assert not before_fit(SindyModel(exact.signature, "auto"), exact).lines


@pytest.mark.parametrize("library", ["auto", "auto_rig"])
def test_an_angle_in_degrees_is_told_the_words_that_read_it_in_rad(tmp_path, library):
    """Degrees that a heading names are converted; these were asked for."""
    log(tmp_path / "log.csv", "time,theta [deg],Omega [deg/s],u", (57.29578, 57.29578, 1.0))
    kept = {"theta": {"name": "theta", "unit": "deg"}, "Omega": {"name": "Omega", "unit": "deg/s"}}
    source = LoggedData(str(tmp_path / "log.csv"), kept).load(None, EXCITATION)
    (words,) = told(source, library)
    assert "theta is in deg" in words and "sin(theta)" in words
    # The words are those of a shell, and read what makes a library with sines.
    (word,) = shlex.split(words.rpartition("give ")[2])
    states = yaml.safe_load(word.removeprefix("data.states="))
    read = LoggedData(str(tmp_path / "log.csv"), states).load(None, EXCITATION)
    assert read.signature.state_units == ("rad", "rad/s") and not told(read)
    assert float(read.training.x[:, 0].abs().max() / source.training.x[:, 0].abs().max()) == pytest.approx(0.01745329)
    assert not told(source, ["theta", "Omega", "u"])  # whoever names the functions has chosen
    # A rate that no column has is no column to be read: `plant.known` adds it.
    x = source.training.x.clone()
    x[:, 1] = torch.nan
    (words,) = told(replace(source, training=replace(source.training, x=x)), library)[:1]
    (word,) = shlex.split(words.rpartition("give ")[2])
    assert list(yaml.safe_load(word.removeprefix("data.states="))) == ["theta"]


def test_an_angle_without_its_rate_in_rad_is_told_of_it(tmp_path):
    (words,) = told(log(tmp_path / "log.csv", "time,theta [rad],Omega [1/s],u"))
    assert "of theta only sin(theta)" in words
    assert "plant.known={theta: theta_rate}" in words
    source = LoggedData(str(tmp_path / "log.csv")).load(None, EXCITATION)
    model = SindyModel(source.signature, "auto")
    lacking = rates_lacking(model, source)
    assert lacking.with_angles == {"theta": "theta_rate"} and not lacking.shown
    steps = rates_lacking(SindyModel(source.signature, "auto", time="discrete"), source)
    assert not steps.with_angles and not steps.shown  # a difference equation has no rates
    chosen = SindyModel(source.signature, ["theta", "Omega", "u"])
    assert not rates_lacking(chosen, source).with_angles


def test_a_rate_that_is_missing_is_told_once_and_not_once_it_is_given(tmp_path, write_log):
    """The pendulum's angle, read by an encoder alone."""
    data = record_plant(Pendulum(), Aprbs(1, 8.0, amplitude=0.4, seed=0).samples(0.01), 0.01)
    path = str(write_log(tmp_path / "log.csv", ["a [rad]", "u"], data.x[:, :1], data.u))
    source = LoggedData(path).load(None, EXCITATION)
    (hint,) = told(source)
    assert "depends" in hint and "'plant.known={a: a_rate}'" in hint
    known = LoggedData(path, known={"a": "a_rate"}).load(None, EXCITATION)
    found, rates, words = with_missing_rates(partial(SindyModel, library="auto"), source, None)
    assert rates == {"a": "a_rate"} and found.signature == known.signature
    assert words == [
        "note: what a will do depends on its rate, which the log lacks. It is estimated with the model, as if "
        "'plant.known={a: a_rate}' had been given; 'plant.known={}' leaves that out"
    ]
    for library, given in (("auto", {}), (["1", "a", "u"], None)):  # nobody wants it, or the functions are chosen
        assert with_missing_rates(partial(SindyModel, library=library), source, given) == (source, {}, [])
    model = SindyModel(known.signature, "auto", known={"a": "a_rate"})
    clock, unseen = before_fit(model, known).lines
    assert "column" in clock and clock.endswith(": 0.01 s between rows")
    assert "a_rate" in unseen
    assert rates_lacking(model, known).shown == {"a": "a_rate"}
    assert before_fit(model, known).lacking == rates_lacking(model, known)


def test_a_missing_rate_is_named_so_that_words_can_hold_it_and_nothing_else_has_it(tmp_path, write_log):
    data = record_plant(Pendulum(), Aprbs(1, 8.0, amplitude=0.4, seed=0).samples(0.01), 0.01)
    path = str(write_log(tmp_path / "log.csv", ["arm angle [rad]", "arm_angle_rate"], data.x[:, :1], data.u))
    source = LoggedData(path, inputs=["arm_angle_rate"]).load(None, EXCITATION)
    found, rates, _ = with_missing_rates(partial(SindyModel, library="auto"), source, None)
    assert rates == {"arm angle": "arm_angle_rate_"} and found.signature.state_names == tuple(*rates.items())
    assert SindyModel(found.signature, "auto", known=rates).signature == found.signature


def test_few_rows_are_told_with_what_was_left_out(tmp_path):
    heading = "time,theta [rad],Omega [rad/s],u"
    words = told(log(tmp_path / "log.csv", heading, rows=61), ["theta", "Omega", "u", "sin(theta)"])[0]
    assert "has 45 rows" in words  # three quarters of 60
    enough = told(log(tmp_path / "log.csv", heading, rows=81), ["theta", "Omega", "u", "sin(theta)"])
    assert not any("rows only" in line for line in enough)
    lines = (tmp_path / "log.csv").read_text().splitlines()
    (tmp_path / "log.csv").write_text("\n".join([*lines[:30], "0.3,,,", *lines[31:62]]))
    words = told(LoggedData(str(tmp_path / "log.csv")).load(None, EXCITATION), ["theta", "Omega", "u", "sin(theta)"])
    assert "rows" in words[0] and "1 of 61 rows" in words[1]


def test_many_functions_are_counted_and_the_plants_named_that_have_fewer(tmp_path):
    data, signature = Simulated().load(Tras(), partial(Chirp, duration=3.0)).training, Tras().signature
    units = (f"{n} [{u}]" for n, u in zip(signature.state_names, signature.state_units, strict=True))
    rows = [",".join(map(str, (k * data.dt, *data.x[k].tolist(), *data.u[k].tolist()))) for k in range(len(data))]
    (tmp_path / "log.csv").write_text("\n".join([",".join(["time", *units, *signature.input_names]), *rows]))
    source = LoggedData(str(tmp_path / "log.csv")).load(None, EXCITATION)
    (words,) = told(source)
    library = SindyModel(source.signature, "auto").library  # of its four quotients a fit keeps those of one angle
    others = ("alpha_a)^2)", "alpha_a + alpha_p)^2)", "alpha_a - alpha_p)^2)")
    count = int(words.split()[5])
    assert len([name for name in library.names if not name.endswith(others)]) >= count > len(library) / 4
    assert words.startswith(f"note: the fit chooses from {count} candidate functions by {len(source.training)} rows")
    assert "tras, trms33, xi," in words
    assert not told(source, "rotor")
    # The columns of no plant of the package: fewer than 150 functions are many for few rows alone.
    lines = (tmp_path / "log.csv").read_text().replace("alpha_a", "yaw", 1).splitlines()
    for number, many in ((101, True), (len(lines), False)):
        (tmp_path / "log.csv").write_text("\n".join(lines[:number]))
        words = told(LoggedData(str(tmp_path / "log.csv")).load(None, EXCITATION))
        assert ["system=" not in line for line in words if "plant.library=" in line] == [True] * many


def test_every_plant_that_is_named_is_an_option():
    options = Path(__file__).parents[2] / "conf" / "system"
    for name, plant in PLANTS.items():
        assert f"dynasindy.systems.{plant.__name__}" in (options / f"{name}.yaml").read_text()
