"""From a source of data to a model, its figures and its files."""

import math
from functools import cache, partial

import numpy as np
import pytest
import torch

from dynasindy.dyna.simulated import Simulated
from dynasindy.envs import Aprbs, Chirp
from dynasindy.findings import LogError, note
from dynasindy.identification.identify import Identified, LoggedData
from dynasindy.identification.source import Source
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.systems import Pendulum, Signature, Tras
from dynasindy.systems.integrators import moved
from dynasindy.systems.transitions import Transitions

EXCITATION = partial(Chirp, duration=10.0, amplitude=0.6)


@cache
def simulated():
    return Simulated(substeps=2, validation_seconds=5.0).load(Pendulum(), EXCITATION)


def codes(findings):
    return [each.code for each in findings]


def _identified(source):
    model = SindyModel(
        source.signature, ["theta", "Omega", "u", "sin(theta)"], Regression("bic"), Refinement("one_step")
    )
    return Identified.of(model, source)


def test_the_pendulum_is_found_and_predicts_unseen_inputs():
    source = simulated()
    found = _identified(source)
    assert found.model.equations(3)[1] == "Omega' = -0.5 Omega + 12 u - 9.81 sin(theta)"
    assert max(found.metrics["open_loop_nrmse"].values()) < 1e-4
    errors = dict(zip(("theta", "Omega"), found.forecasts.model[0].tolist(), strict=True))
    assert found.metrics[f"rmse_{found.forecasts.horizons[0]:g}_s"] == errors
    assert "prediction" in found.to_text() and codes(found.verdict) == ["model.predicts"]


def test_of_an_exact_log_nothing_stays_unexplained_and_of_a_poor_library_what_single_steps_miss():
    """The trapezoid that the regression begins with leaves over a hundredth of a percent even of an exact log."""
    source = simulated()
    found = _identified(source)
    assert max(found.report.residual.values()) < 1e-6
    poor = SindyModel(source.signature, ["theta", "Omega", "u"], refinement=Refinement("one_step"))
    found, data = Identified.of(poor, source), source.training
    left = (moved(found.model, data.x, data.u, data.dt, 4) - data.x_next).norm(dim=0)
    parts = (left / (data.x_next - data.x).norm(dim=0)).tolist()
    assert list(found.report.residual.values()) == pytest.approx(parts, rel=1e-3) and parts[1] > 1e-3


def test_a_log_of_the_pendulum_gives_the_pendulum(tmp_path):
    data = simulated().training
    lines = ["t,angle,rate,torque"]
    for k in range(len(data)):
        lines.append(f"{k * data.dt},{data.x[k, 0] * 57.29577951308232},{data.x[k, 1]},{data.u[k, 0]}")
    (tmp_path / "log.csv").write_text("\n".join(lines))
    states = {"theta": {"name": "angle", "unit": "rad", "scale": 0.017453292519943295}, "Omega": "rate"}
    source = LoggedData(str(tmp_path / "log.csv"), states, {"u": "torque"}, time="t").load(Pendulum(), EXCITATION)
    assert _identified(source).model.equations(3)[1] == "Omega' = -0.5 Omega + 12 u - 9.81 sin(theta)"
    assert len(source.validation) == pytest.approx(250, abs=2)


def test_columns_of_a_log_of_no_plant_are_named_by_a_list_or_a_map(tmp_path):
    rows = [f"{0.1 * k},{math.sin(k)},{math.cos(k)},{math.cos(2 * k)},{math.sin(3 * k)}" for k in range(60)]
    (tmp_path / "log.csv").write_text("\n".join(["time [s],a [rad],b [m],motor [V],c [m]", *rows]))

    def names(**given):
        signature = LoggedData(str(tmp_path / "log.csv"), **given).recording(None).signature
        return signature.state_names, signature.state_units, signature.input_names

    assert names(inputs=["motor"]) == (("a", "b", "c"), ("rad", "m", "m"), ("motor",))
    assert names(inputs={"u": "motor"}) == (("a", "b", "c"), ("rad", "m", "m"), ("u",))
    assert names(states=["c", "a [rad]"], inputs=["motor"]) == (("c", "a"), ("m", "rad"), ("motor",))
    assert names(states={"x": "b"}, inputs=["motor"])[0] == ("x",)
    with pytest.raises(ValueError, match="columns"):
        names(states=["motor"], inputs=["motor"])
    with pytest.raises(LogError) as error:
        names()
    assert error.value.finding.values["guess"]


def test_a_log_without_a_map_has_the_names_of_the_plant_or_those_of_its_headings(tmp_path):
    data = simulated().training
    rows = torch.cat(
        [torch.arange(len(data)).unsqueeze(-1) * data.dt, data.x, data.x[:, :1].sinh(), data.u], -1
    ).tolist()
    lines = ["time,theta,Omega,spare [m],u", *(",".join(map(repr, row)) for row in rows)]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    named = LoggedData(str(tmp_path / "log.csv")).load(Pendulum(), EXCITATION).signature
    assert named.state_names == ("theta", "Omega") and named.state_units == Pendulum().signature.state_units
    read = LoggedData(str(tmp_path / "log.csv")).load(None, EXCITATION).signature
    assert read.state_names == ("theta", "Omega", "spare") and read.state_units == ("-", "-", "m")
    mine = LoggedData(str(tmp_path / "log.csv"), inputs={"torque": "u"}).load(None, EXCITATION).signature
    assert mine.input_names == ("torque",)


def test_the_simulated_plant_begins_where_it_is_said_to():
    begun = Simulated(validation_seconds=2.0, start={"theta": 0.5}).load(Pendulum(), partial(Chirp, duration=2.0))
    assert begun.training.x[0].tolist() == begun.validation.x[0].tolist() == [0.5, 0.0]
    drawn = Simulated(validation_seconds=2.0, start={"theta": [0.2, 0.6]}).load(
        Pendulum(), partial(Chirp, duration=2.0)
    )
    first, other = (float(data.x[0, 0]) for data in (drawn.training, drawn.validation))
    assert 0.2 < first < 0.6 and 0.2 < other < 0.6 and first != other
    with pytest.raises(ValueError, match="start"):
        Simulated(start={"phi": 1}).load(Pendulum(), partial(Chirp, duration=2.0))


def test_samples_at_a_stop_are_left_out_and_counted():
    hard = partial(Chirp, duration=3.0, amplitude=1.0)
    plant = Tras(azimuth_stop=0.05)
    source = Simulated(substeps=1, validation_seconds=0.1).load(plant, hard)
    left_out = 300 - len(source.training)
    assert left_out > 0 and source.findings == (note("log.touched_stop", count=left_out),)


def test_the_last_part_of_a_log_is_for_validation(tmp_path):
    lines = ["time,theta,Omega,u", *(f"{0.1 * k:.1f},{k},{k % 7},{k % 3}" for k in range(101))]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    source = LoggedData(str(tmp_path / "log.csv"), validation_share=0.3).load(Pendulum(), EXCITATION)
    assert source.training.x[:, 0].tolist() == [*range(70)]
    assert source.validation.x[:, 0].tolist() == [*range(70, 100)]


def test_a_rate_of_the_plant_needs_no_column_and_is_estimated_with_the_model(tmp_path):
    data = simulated().training
    rows = torch.cat([torch.arange(len(data)).unsqueeze(-1) * data.dt, data.x[:, :1], data.u], -1).tolist()
    (tmp_path / "log.csv").write_text("\n".join(["time,theta,u", *(",".join(map(repr, row)) for row in rows)]))
    path = str(tmp_path / "log.csv")
    source = LoggedData(path, known={"theta": "Omega"}).load(Pendulum(), EXCITATION)
    assert source.signature.state_names == ("theta", "Omega") and bool(source.training.x[:, 1].isnan().all())
    assert source.signature.x_scale[1] == Pendulum().signature.x_scale[1]
    refinement = Refinement("trajectory")
    library = ["theta", "Omega", "u", "sin(theta)"]
    model = SindyModel(source.signature, library, Regression("bic"), refinement, known={"theta": "Omega"})
    found = Identified.of(model, source)
    assert found.model.equations(3)[1] == "Omega' = -0.5 Omega + 12 u - 9.81 sin(theta)"
    assert "fit.trajectories" in codes(found.report.findings) and codes(found.verdict) == ["model.predicts"]
    assert set(found.metrics["open_loop_nrmse"]) == {"theta"} and not any(
        "nan" in str(v) for v in found.metrics.values()
    )
    with pytest.raises(ValueError, match="no column 'Omega'"):
        LoggedData(path).load(Pendulum(), EXCITATION)


def test_no_verdict_is_given_on_a_log_that_is_too_quiet_to_tell():
    """An angle read by an encoder of 4096 steps a turn, which moves by some four of them."""
    step, t = 2 * math.pi / 4096, 0.02 * torch.arange(1001, dtype=torch.float64)
    signature = Signature(("angle",), ("rad",), ("u",), (1.0,))

    def found(amplitude):
        angle = (amplitude * torch.sin(t) / step).round() * step
        log = Transitions.from_trajectory(angle.unsqueeze(-1), torch.cos(t)[:-1].unsqueeze(-1), 0.02)
        model = SindyModel(signature, ["1", "u", "angle"])
        return Identified.of(
            model,
            Source(signature, log.select(torch.arange(1000) < 750), log.select(torch.arange(1000) >= 750)),
        )

    quiet, loud = found(2 * step), found(500 * step)
    assert codes(quiet.verdict) == ["log.low_signal"] and not quiet.predicts
    assert all(code.startswith("model.") for code in codes(loud.verdict)) and loud.verdict and not loud.quiet
    assert "quiet" in quiet.to_text().splitlines()[-1]


def test_several_logs_are_read_and_a_column_may_stand_still_in_one_of_them(tmp_path):
    t = 0.01 * np.arange(100)
    moving, still = np.stack([t, np.sin(t), np.sign(np.sin(9 * t + 0.1))], -1), np.stack([t, np.cos(t), 0 * t], -1)
    for name, table in (("still", still), ("moving", moving)):
        np.savetxt(tmp_path / f"{name}.csv", table, delimiter=",", header="time [s],way [m],u", comments="")
    both = [str(tmp_path / f"{name}.csv") for name in ("still", "moving")]
    found = LoggedData(both).recording(None)
    assert found.signature.state_names == ("way",) and found.signature.input_names == ("u",)
    assert found.transitions.segment.bincount().tolist() == [99, 99]
    assert {each.code for each in found.findings} == {"log.time"}


def test_a_motion_that_is_fast_against_the_samples_does_not_run_away_in_the_prediction():
    """A current that follows its voltage within 2 ms, in samples every 0.01 s: one Runge-Kutta step makes it grow."""
    plant, dt = Signature(("v", "i"), ("m/s", "A"), ("u",), (1.0, 1.0)), 0.01
    truth = SindyModel(plant, ["v", "i", "u"])
    truth.coefficients = torch.tensor([[-1.0, 0.0], [1.0, -500.0], [0.0, 500.0]]).double()
    u = Aprbs(1, duration=6.0, dt=dt, amplitude=0.6).samples(dt)
    x = truth.simulate(torch.zeros(2).double(), u.double(), dt, 100)
    data = Transitions(x[:-1], u.double(), x[1:], dt, torch.zeros(len(u), dtype=torch.long))
    rows = torch.arange(len(u))
    source = Source(plant, data.select(rows < 400), data.select(rows >= 400))
    found = Identified.of(SindyModel(plant, ["v", "i", "u"], Regression("bic"), Refinement("one_step")), source)
    assert max(found.metrics["open_loop_nrmse"].values()) < 0.01 > max(found.metrics["one_step_error"].values())
