"""What is found before a fit: wrong units first, then what was read."""

from functools import cache, partial

import pytest

from dynasindy.dyna.simulated import Simulated, record_plant
from dynasindy.envs import Aprbs, Chirp
from dynasindy.findings import note
from dynasindy.identification.identify import LoggedData, before_fit
from dynasindy.sindy import SindyModel
from dynasindy.systems import Pendulum

EXCITATION = partial(Chirp, duration=5.0)


@cache
def simulated():
    return Simulated(validation_seconds=2.0).load(Pendulum(), EXCITATION)


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


def test_a_rate_that_is_known_and_was_not_logged_is_a_state_and_said_to_be(tmp_path, write_log):
    """The pendulum's angle, read by an encoder alone."""
    data = record_plant(Pendulum(), Aprbs(1, 8.0, amplitude=0.4, seed=0).samples(0.01), 0.01)
    path = str(write_log(tmp_path / "log.csv", ["a [rad]", "u"], data.x[:, :1], data.u))
    known = LoggedData(path, known={"a": "a_rate"}).load(None, EXCITATION)
    clock, unseen = before_fit(SindyModel(known.signature, "auto", known={"a": "a_rate"}), known)
    assert clock.code == "log.time" and clock.values["dt"] == pytest.approx(0.01)
    assert unseen == note("log.unmeasured", state="a_rate")
