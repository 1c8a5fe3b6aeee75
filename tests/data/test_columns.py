"""A guess at the columns of a log, read back by what it is for."""

import math

import numpy as np
import pytest

from dynasindy.data.columns import find_clock, infer
from dynasindy.data.table import Table
from dynasindy.findings import LogError, note, weak, wrong
from dynasindy.identification.identify import LoggedData


def written(path, headings, order=(0, 1, 2, 3)):
    """Write time, a swing, its rate and a command that is held for nine samples, in some order of columns."""
    t = 0.01 * np.arange(200)
    rows = np.stack([t, np.sin(t) + 0.1, np.cos(9 * t), np.arange(200) // 9 % 3 - 1.0], -1)[:, list(order)]
    return write(path, headings, *rows.T)


def write(path, headings, *columns):
    """Write columns of numbers below headings, nothing for NaN, and return the path."""
    rows = np.stack(columns, -1).tolist()
    path.write_text("\n".join([headings, *(",".join("" if v != v else repr(v) for v in row) for row in rows)]))
    return path


def refused(read):
    with pytest.raises(LogError) as error:
        read()
    assert "\n" not in str(error.value)
    return error.value.finding


def roles(guess):
    return {key: guess[key] for key in ("time", "inputs", "states")}


@pytest.mark.parametrize(
    ("headings", "order"),
    [
        ("Zeit,Winkel,Rate,Befehl", (0, 1, 2, 3)),
        ("Befehl,Winkel,Rate,Zeit", (3, 1, 2, 0)),
        ("Zeit,Winkel [rad],Rate,der Befehl (V)", (0, 1, 2, 3)),
    ],
)
def test_the_first_error_has_all_settings_and_these_read_the_log(tmp_path, headings, order):
    path = written(tmp_path / "log.csv", headings, order)
    told = refused(lambda: LoggedData(str(path)).recording(None))
    assert told.code == "log.no_roles" and told.values["lacks"] == "time"
    given = roles(told.values["guess"])
    assert given["time"] == "Zeit" and given["states"] == ["Winkel", "Rate"]
    found = LoggedData(str(path), **given).recording(None)
    assert set(np.unique(found.transitions.u)) == {-1.0, 0.0, 1.0} and found.transitions.dt == pytest.approx(0.01)


def test_a_column_that_never_changes_is_no_input_and_no_state_and_is_said(tmp_path):
    """It is held longer than any other."""
    path = tmp_path / "log.csv"
    rows = [f"{0.1 * k},{math.sin(k)},{k // 4 % 2},24.5" for k in range(80)]
    path.write_text("\n".join(["time,angle,motor,supply", *rows]))
    still = note("log.left_out", why="constant", columns={"supply": 24.5})
    states, inputs, told = infer(Table.read(path))
    assert (list(states), list(inputs)) == (["angle"], ["motor"]) and still in told
    assert told[-1] == weak("log.guessed_inputs", inputs=["motor"], states=["angle"], named=False)
    found = LoggedData(str(path), inputs=["motor"]).recording(None)
    assert found.signature.state_names == ("angle",) and still in found.findings
    path.write_text("\n".join(["time,angle,u_motor,u_supply", *rows]))
    found = LoggedData(str(path)).recording(None)
    assert found.signature.input_names == ("u_motor",)
    assert note("log.left_out", why="constant", columns={"u_supply": 24.5}) in found.findings
    assert LoggedData(str(path), states=["angle"]).recording(None).signature.input_names == ("u_motor",)


def test_dates_are_taken_for_the_time_and_a_counter_only_where_there_is_no_other(tmp_path):
    path = tmp_path / "log.csv"
    rows = [f"{k},31.05.2024 12:00:{k // 10:02d}.{k % 10},{math.sin(k)},{k // 4 % 2},{0.1 * k}" for k in range(80)]
    path.write_text("\n".join(["row,Uhr,Winkel,Motor,Zeit", *rows]))
    given = roles(refused(lambda: infer(Table.read(path))).values["guess"])
    assert given["time"] == "Uhr" and given["inputs"] == ["Motor"]
    assert LoggedData(str(path), **given).recording(None).transitions.dt == pytest.approx(0.1)
    path.write_text(
        "\n".join(["row,Winkel,Motor,Zeit", *(",".join(np.array(r.split(","))[[0, 2, 3, 4]]) for r in rows)])
    )
    assert refused(lambda: infer(Table.read(path))).values["guess"]["time"] == "Zeit"
    path.write_text("\n".join(["row,Winkel,Motor", *(",".join(np.array(r.split(","))[[0, 2, 3]]) for r in rows)]))
    guess = refused(lambda: infer(Table.read(path))).values["guess"]
    assert guess["time"] == "row"


def test_of_two_columns_of_dates_the_first_may_be_the_time_and_the_other_is_left_out(tmp_path):
    path = tmp_path / "log.csv"
    date = "31.05.2024 12:00:{:02d}.{}".format
    rows = [f"{date(k // 10, k % 10)},{date(k // 10 + 1, 0)},{math.sin(k)},{k // 4 % 2}" for k in range(80)]
    path.write_text("\n".join(["Uhr,Datei,Winkel,Motor", *rows]))
    told = refused(lambda: infer(Table.read(path))).values["left_out"]
    assert note("log.left_out", why="dates", columns=["Datei"]) in told


def rows_of_a_swing(path, headings, columns):
    """Write rows of numbers; `columns` makes them of the number of the row."""
    path.write_text("\n".join([headings, *(",".join(map(str, columns(k))) for k in range(80))]))
    return str(path)


@pytest.mark.parametrize("step", [1, 5])
def test_with_a_sampling_time_a_counter_is_the_time_and_nothing_more_is_asked_for(tmp_path, step):
    path = rows_of_a_swing(tmp_path / "log.csv", "row,angle,u", lambda k: (step * k, math.sin(k), k // 4 % 2))
    assert refused(lambda: LoggedData(path).recording(None)).code == "log.no_roles"
    found = LoggedData(path, dt=0.02).recording(None)
    assert found.transitions.dt == 0.02 and len(found.transitions) == 79
    assert found.signature.state_names == ("angle",) and found.signature.input_names == ("u",)
    assert found.findings[0] == note("log.row_counter", column="row", dt=0.02)


@pytest.mark.parametrize("clock", ["t", "Time [s]", "2024"])
def test_the_time_is_no_state_and_no_input(tmp_path, clock):
    heading = "time" if clock == "2024" else clock
    dates = [f"2024-05-31 12:{k:02}:00" if clock == "2024" else 0.1 * k for k in range(80)]
    path = rows_of_a_swing(
        tmp_path / "a.csv", f"{heading},angle,u", lambda k: (dates[k], math.sin(k), k // 4 % 2 + k % 3)
    )
    for roles in ({"states": {"clock": heading, "angle": "angle"}}, {"inputs": {"clock": heading, "u": "u"}}):
        told = refused(lambda roles=roles: LoggedData(path, **roles).recording(None))
        assert (told.code, told.values["column"]) == ("log.time_named", heading)


def test_nothing_is_guessed_of_a_log_in_which_one_thing_moves(tmp_path):
    path = rows_of_a_swing(tmp_path / "a.csv", "time,angle", lambda k: (0.1 * k, math.sin(k)))
    finding = refused(lambda: LoggedData(path).recording(None))
    assert finding.values["lacks"] == "inputs" and "guess" not in finding.values


def test_a_counter_is_not_the_time_where_something_else_may_be(tmp_path):
    """A time in another language, an encoder that only grows, and a column that was named as a state."""
    two = rows_of_a_swing(tmp_path / "a.csv", "row,Zeit,angle,u", lambda k: (k, 0.1 * k, math.sin(k), k // 4 % 2))
    assert refused(lambda: LoggedData(two, dt=0.1).recording(None)).values["guess"]["time"] == "Zeit"
    encoder = rows_of_a_swing(tmp_path / "b.csv", "counts,angle,u", lambda k: (k * k, math.sin(k), k // 4 % 2))
    assert refused(lambda: LoggedData(encoder, dt=0.1).recording(None)).code == "log.no_roles"
    named = rows_of_a_swing(tmp_path / "c.csv", "row,angle,u", lambda k: (k, math.sin(k), k // 4 % 2))
    for states in (["row", "angle"], {"way": "row", "angle": {"name": "angle"}}):
        found = LoggedData(named, states, {"u": "u"}, dt=0.1).recording(None)
        assert found.signature.n_x == 2 and found.transitions.dt == 0.1


def test_rows_of_a_log_without_any_time_are_even_where_the_sampling_time_is_given(tmp_path):
    path = rows_of_a_swing(tmp_path / "log.csv", "angle,u", lambda k: (math.sin(k), k // 4 % 2))
    assert refused(lambda: LoggedData(path).recording(None)).values["guess"]["time"] is None
    found = LoggedData(path, dt=0.1).recording(None)
    assert found.transitions.dt == 0.1 and found.signature.state_names == ("angle",)
    assert found.transitions.x[:, 0].tolist() == pytest.approx([math.sin(k) for k in range(len(found.transitions))])


def test_an_encoder_of_a_motor_that_turns_one_way_is_no_counter_of_rows(tmp_path):
    """It grows by three or four in each row, by chance; a counter grows by one, or by more where rows were lost."""
    rng = np.random.default_rng(0)
    u, path = rng.uniform(-1, 1, 300), tmp_path / "log.csv"
    for name, steps in (("row", 1 + 2 * (rng.random(300) < 0.02)), ("encoder", 3 + (rng.random(300) < 0.3))):
        write(path, f"u,{name},speed", u, np.cumsum(steps), np.sin(np.arange(300)))
        assert find_clock(Table.read(path), "time", [], 0.02) == ("row" if name == "row" else "time")


def closed_loop(rows=1500):
    """Return time, a reference in steps, a first-order plant that follows it, and what drives it, by hand."""
    rng = np.random.default_rng(2)
    r, y, e = np.repeat(rng.uniform(-1, 1, rows // 100), 100), np.zeros(rows), rng.normal(0, 0.1, rows)
    u = np.zeros(rows)
    for k in range(rows - 1):
        u[k] = 3 * (r[k] - y[k]) + r[k] + e[k]
        y[k + 1] = y[k] + 0.01 * 5 * (u[k] - y[k])
    return {"t": 0.01 * np.arange(rows), "r": r, "y": y, "u": u}


def codes(recording):
    return {each.code: each for each in recording.findings}


@pytest.mark.parametrize(
    ("heading", "scale"), [("tempo_ms", 1000), ("Zeit [s]", 1), ("Run_1_Time (min)", 1 / 60), ("reloj us", 1e6)]
)
def test_the_only_column_with_a_unit_of_time_is_the_clock_whatever_it_is_called(tmp_path, heading, scale):
    loop = closed_loop()
    path = write(tmp_path / "log.csv", f"{heading},y,u", loop["t"] * scale, loop["y"], loop["u"])
    found = LoggedData(str(path)).recording(None)
    assert found.transitions.dt == pytest.approx(0.01) and found.signature.state_names == ("y",)


@pytest.mark.parametrize(
    "name", ["referencia", "sollwert", "consigna", "y_ref", "SetPoint", "target_1", "SP", "desired_y"]
)
def test_a_reference_is_left_out_by_its_name_unless_it_is_named(tmp_path, name):
    loop, path = closed_loop(), tmp_path / "log.csv"
    write(path, f"t,{name},y,u", *loop.values())
    found = LoggedData(str(path)).recording(None)
    assert found.signature.state_names == ("y",)
    assert codes(found)["log.left_out"] == note("log.left_out", why="reference", columns=[name])
    assert LoggedData(str(path), states=["y", name]).recording(None).signature.state_names == ("y", name)
    assert LoggedData(str(path), inputs=[name]).recording(None).signature.input_names == (name,)


def test_a_reference_by_another_name_is_one_by_what_follows_it_and_a_slow_sensor_is_none(tmp_path):
    loop, path = closed_loop(), tmp_path / "log.csv"
    slow = loop["y"][np.arange(len(loop["y"])) // 40 * 40]
    for second, states in ((loop["r"], ("y",)), (slow, ("a", "y"))):
        write(path, "t,a,y,u", loop["t"], second, loop["y"], loop["u"])
        found = LoggedData(str(path)).recording(None)
        assert found.signature.state_names == states
        assert ("log.followed" in codes(found)) == (states == ("y",))
    held = np.repeat(np.random.default_rng(5).uniform(-1, 1, 75), 20)
    found = LoggedData(str(write(path, "t,a,y,drive", loop["t"], loop["r"], loop["y"], held))).recording(None)
    assert found.signature.input_names == ("drive",) and codes(found)["log.followed"].severity == "weak"


def test_columns_that_move_in_steps_are_the_inputs_where_no_heading_says_so_and_others_are_not(tmp_path):
    t = np.arange(600.0)
    rng = np.random.default_rng(4)
    one, two = (np.repeat(rng.uniform(0, 50, 600 // n), n) for n in (30, 20))
    a, b = (np.convolve(x, np.ones(50) / 50)[:600] + rng.normal(0, 0.1, 600) for x in (one, two))
    path = tmp_path / "log.csv"

    def read(headings, *columns):
        return LoggedData(str(write(path, headings, *columns))).recording(None)

    found = read("Time (sec), Heater 1, Heater 2, Temperature 1, Temperature 2", t, one, two, a, b)
    assert found.signature.input_names == ("Heater 1", "Heater 2")
    assert codes(found)["log.guessed_inputs"].severity == "weak"
    for headings, columns in (
        ("time,x,y,a,b", (t, one, two, a, b)),  # which of them drives the plant nobody knows
        ("time,a,b,c", (t, a, b, rng.normal(0, 1, 600))),
        ("time,a,b,phase", (t, a, b, t // 200)),  # a label
        ("time,x_1,x_2", (t, one, two)),
    ):
        with pytest.raises(LogError):
            read(headings, *columns)


def multisine(t, seed):
    rng = np.random.default_rng(seed)
    return sum(np.sin(w * t + p) for w, p in zip(rng.uniform(1.0, 9.0, 6), rng.uniform(0, 6.3, 6), strict=True)) / 3


def simulated(slopes, inputs, dt=0.01):
    """Return states of a plant at rest by Euler's method; `slopes` takes them and the inputs, which may read them."""
    x, rows, moved = None, [], []
    for u in inputs:
        x = np.zeros(len(slopes(np.zeros(9), u(np.zeros(9))))) if x is None else x
        rows.append(x)
        moved.append(u(x))
        x = x + dt * np.array(slopes(x, moved[-1]))
    return [*np.array(rows).T, *np.array(moved).T]


LONG = 0.01 * np.arange(1500)
ARM = simulated(
    lambda x, u: (x[2], x[3], 3 * u[0] - x[2] - np.sin(x[0]), 5 * u[1] - x[3] - 0.4 * x[2] - np.sin(x[0] + x[1])),
    [lambda x, a=a, b=b: (a, b) for a, b in zip(multisine(LONG, 0), multisine(LONG, 1), strict=True)],
)
HELD_ARM = simulated(
    lambda x, u: (x[1], 4 * u[0] - x[1] - 9.81 * np.sin(x[0])),
    [lambda x, r=r: (3 * (r - x[0]) - 0.5 * x[1],) for r in multisine(LONG, 2)],
)
MOTOR = simulated(
    lambda x, u: (2 * x[1] - 0.5 * x[0], (u[0] - x[1] - 0.5 * x[0]) / 0.03),
    [lambda x, v=v: (v,) for v in np.repeat(np.random.default_rng(3).uniform(-1, 1, 75), 20)],
)
TANK = simulated(
    lambda x, u: (0.8 + u[0] - np.sqrt(abs(x[0])),), [lambda x, a=a: (a,) for a in 0.3 * multisine(0.3 * LONG, 4)]
)


@pytest.mark.parametrize("noise", [0.0, 0.003])
@pytest.mark.parametrize(
    ("headings", "columns", "inputs"),
    [
        ("q1 [rad],q2 [rad],dq1 [rad/s],dq2 [rad/s],tau1 [Nm],tau2 [Nm]", ARM, ["tau1", "tau2"]),
        ("q_1,q_2,dq_1,dq_2,torque shoulder,torque elbow", ARM, ["torque shoulder", "torque elbow"]),
        ("angle [rad],rate [rad/s],motor_torque [Nm]", HELD_ARM, ["motor_torque"]),
        ("speed [rad/s],current [A],voltage [V]", MOTOR, ["voltage"]),
        ("motor speed [rpm],motor current [A],motor voltage [V]", MOTOR, ["motor voltage"]),
        ("speed,motor current,duty", MOTOR, ["duty"]),
        ("speed,torque,current command", MOTOR, ["current command"]),
        ("pump level [cm],pump [%]", TANK, ["pump"]),
        ("height [cm],Valve 1 [%]", TANK, ["Valve 1"]),
    ],
)
def test_inputs_are_called_as_actuators_are_and_move_what_follows(tmp_path, headings, columns, inputs, noise):
    rng, count, path = np.random.default_rng(5), len(headings.split(",")) - len(inputs), tmp_path / "log.csv"
    seen = [x + noise * np.ptp(x) * rng.normal(size=len(x)) for x in columns[:count]]
    table = np.stack([LONG, *seen, *columns[count:]], 1)
    np.savetxt(path, table, fmt="%.6f", delimiter=",", header=f"time [s],{headings}", comments="")
    states, found, told = infer(Table.read(path))
    assert list(found) == inputs and len(states) == count
    guessed = [each for each in told if each.code == "log.guessed_inputs"]
    assert [each.values["named"] for each in guessed] == [True] * ("command" not in headings)


HELICOPTER = simulated(
    lambda x, u: (x[2], x[3], 2 * u[0] + 0.6 * u[1] - x[0] - x[2], 4 * u[1] - 0.3 * u[0] - x[3]),
    [lambda x, a=a, b=b: (a, b - 2 * x[1]) for a, b in np.random.default_rng(8).uniform(-1, 1, (50, 2)).repeat(30, 0)],
)
TANKS_OF_TWO = simulated(
    lambda x, u: (2 * u[0] - u[1] - x[0], 3 * u[1] - x[1]),
    [lambda x, a=a, b=b: (a, b) for a, b in np.random.default_rng(7).uniform(0, 9, (50, 2)).repeat(30, 0)],
)
LAGS = simulated(
    lambda x, u: (3 * (u[0] - x[0]), 2 * (x[0] - x[1])),
    [lambda x, a=a: (a,) for a in np.random.default_rng(9).uniform(0, 9, 50).repeat(30)],
)


@pytest.mark.parametrize(
    ("names", "columns", "inputs"),
    [
        ("pitch,yaw,pitch rate,yaw rate,V_pitch [V],V_yaw [V]", HELICOPTER, ["V_pitch", "V_yaw"]),
        ("pitch,yaw,pitch rate,yaw rate,V_pitch [V],V_yaw [rad]", HELICOPTER, ["V_pitch"]),
        ("x middle,x out,x in", LAGS, ["x in"]),
        ("warm,moist,heater [%],vent [%]", [*TANKS_OF_TWO], ["heater", "vent"]),
        ("warm,moist,heater [%],vent [cm]", [*TANKS_OF_TWO], ["heater"]),
    ],
)
def test_an_input_that_a_controller_makes_of_states_is_of_a_kind_with_one_in_steps(tmp_path, names, columns, inputs):
    path, noise = tmp_path / "log.csv", np.random.default_rng(5).normal(0, 0.003, (len(columns), len(LONG)))
    noise[-1 if "x in" in names else -2 :] = 0
    table = np.stack([LONG, *(columns + noise * np.ptp(columns, 1, keepdims=True))], 1)
    np.savetxt(path, table, fmt="%.6f", delimiter=",", header=f"time [s],{names}", comments="")
    assert list(infer(Table.read(path))[1]) == inputs


@pytest.mark.parametrize("force", ["motor_torque [Nm]", "u [N]", "valve [%]"])
def test_what_an_encoder_reads_in_steps_is_no_input_beside_an_actuator_that_moves_in_every_row(tmp_path, force):
    angle, _, torque = HELD_ARM
    table, path = np.stack([LONG, np.round(angle / 0.02) * 0.02, torque], 1), tmp_path / "log.csv"
    np.savetxt(path, table, fmt="%.6f", delimiter=",", header=f"time [s],angle [rad],{force}", comments="")
    assert list(infer(Table.read(path))[1]) == [force.split()[0]]


def test_what_is_called_as_an_actuator_and_moves_nothing_is_no_input(tmp_path):
    """A supply's voltage that nothing follows; of three torques of which none is told apart all are offered."""
    path, rng = tmp_path / "log.csv", np.random.default_rng(6)
    table = np.stack([LONG, np.cumsum(rng.normal(size=len(LONG))), 12 + 0.1 * rng.normal(size=len(LONG))], 1)
    np.savetxt(path, table, fmt="%.6f", delimiter=",", header="time,angle,voltage", comments="")
    told = refused(lambda: infer(Table.read(path)))
    assert told.code == "log.no_roles" and told.values["guess"]["inputs"] == ["voltage"]
    table = np.stack([LONG, *np.cumsum(rng.normal(size=(6, len(LONG))), 1)], 1)
    header = "time,a,tau1 [Nm],tau2 [Nm],b,tau3 [Nm],c"
    np.savetxt(path, table, fmt="%.6f", delimiter=",", header=header, comments="")
    assert refused(lambda: infer(Table.read(path))).values["guess"]["inputs"] == ["tau1", "tau2", "tau3"]


def test_what_moves_in_steps_and_drives_nothing_hides_no_input(tmp_path):
    """The voltage of a battery beside the command of a motor."""
    held, battery = np.repeat(np.random.default_rng(3).uniform(-1, 1, 75), 20), 12.4 - 0.1 * (np.arange(1500) // 300)
    path = write(tmp_path / "log.csv", "time,way,setting,supply", LONG, np.cumsum(MOTOR[1]), held, battery)
    assert list(infer(Table.read(path))[1]) == ["setting"]


def test_where_nothing_acts_what_moves_in_steps_is_guessed_by_how_long_it_stands_and_what_is_measured_is_none(tmp_path):
    """Two ways that nothing drives, one of them read in steps; and a log too short to tell what drives it."""
    rng, ways = np.random.default_rng(3), (multisine(LONG, 2), np.repeat(multisine(LONG, 5)[::20], 20))
    long, short = (np.repeat(rng.uniform(-1, 1, len(LONG) // n), n) for n in (20, 10))
    path = write(tmp_path / "log.csv", "time,x,encoder [mm],first,second", LONG, *ways, long, short)
    assert refused(lambda: infer(Table.read(path))).code == "log.no_roles"
    columns = (column[:150] for column in (LONG, ways[0], long, short))
    path = write(tmp_path / "log.csv", "time,x,first,second", *columns)
    assert refused(lambda: infer(Table.read(path))).values["guess"]["inputs"] == ["first"]


def test_a_first_guess_takes_what_acts_and_neither_references_nor_what_follows_from_others(tmp_path):
    reference, noise = multisine(LONG, 2), 1e-3 * np.random.default_rng(7).normal(size=(2, len(LONG)))
    path = write(
        tmp_path / "log.csv",
        "time,Sollwinkel,Regelfehler,Ventil,Winkel,Rate",
        *(LONG, reference, reference - HELD_ARM[0], HELD_ARM[2], HELD_ARM[0] + noise[0], HELD_ARM[1] + noise[1]),
    )
    guess = refused(lambda: infer(Table.read(path))).values["guess"]
    assert guess["inputs"] == ["Ventil"]


@pytest.mark.parametrize("names", ["setting,current [A],omega", "Q [%],T pump,T2", "Q,motor [rad],load [rad]"])
@pytest.mark.parametrize("states", [None, (1, 2)])
def test_what_is_called_an_actuator_and_follows_a_column_in_steps_is_a_state(tmp_path, names, states):
    u, x, y = np.repeat(np.random.default_rng(1).uniform(0, 10, 20), 50), np.zeros(1000), np.zeros(1000)
    for k in range(999):
        x[k + 1], y[k + 1] = x[k] + 0.2 * (3 * u[k] - x[k]), y[k] + 0.05 * (x[k] - y[k])
    path = write(tmp_path / "log.csv", f"t [s],{names}", 0.01 * np.arange(1000), u, x, y)
    plain = [name.split(" [")[0] for name in names.split(",")]
    found = infer(Table.read(path), "t", states=states and [plain[k] for k in states])
    assert (list(found[1]), list(found[0])) == (plain[:1], plain[1:])


ROWS = 400
T = 0.01 * np.arange(ROWS)
ANGLE = 8 * np.sin(1.5 * T) ** 2
COMMAND = 0.7 * np.sin(7 * T) + 0.2 * np.cos(19 * T)


def recording(path, headings, *columns, **settings):
    return LoggedData(str(write(path, headings, *columns)), **settings).recording(None)


def of_lines(path, *lines, **settings):
    path.write_text("\n".join(lines))
    return LoggedData(str(path), **settings).recording(None)


@pytest.mark.parametrize(
    ("heading", "stamps"),
    [
        ("timestamp", 1_717_156_800_000 + 1000 * T),
        ("timestamp", 1_717_156_800_000_000 + 1e6 * T),
        ("Time(ms)", (65_000 + 1000 * T) % 2**16),
        ("micros", (2**32 - 1_000_000 + 1e6 * T) % 2**32),
        ("time [s]", (86_398 + T) % 86_400),
        ("time", np.floor(np.arange(ROWS) / 2) * 0.02),
    ],
)
def test_clocks_of_devices_give_the_time_between_rows(tmp_path, heading, stamps):
    found = recording(tmp_path / "l.csv", f"{heading},angle,u", np.round(stamps, 4), ANGLE, COMMAND)
    assert found.transitions.dt == pytest.approx(0.01, rel=1e-4) and len(found.transitions) == ROWS - 1
    assert found.transitions.segment.unique().tolist() == [0]


def test_whole_numbers_that_are_hardly_seconds_ask_for_their_unit(tmp_path):
    path = tmp_path / "l.csv"
    with pytest.raises(LogError) as error:
        recording(path, "timestamp,angle,u", 183_254_000 + 1e6 * T, ANGLE, COMMAND)
    assert error.value.finding == wrong("log.no_time_unit", file=str(path), column="timestamp", step=1e4)
    found = LoggedData(str(path), time="timestamp [us]").recording(None)
    assert found.transitions.dt == pytest.approx(0.01)


def test_rows_of_two_streams_are_one_log(tmp_path):
    """A command in every second row stands until the next; a measurement stands where it was made."""
    odd = np.arange(ROWS) % 2 == 1
    found = recording(
        tmp_path / "l.csv", "time,angle,cmd", T, np.where(odd, ANGLE, np.nan), np.where(odd, np.nan, COMMAND)
    )
    data, rows = found.transitions, np.arange(1, ROWS - 1)
    assert data.x[:, 0].isfinite().tolist() == [bool(k % 2) for k in rows]
    assert data.u[:, 0].numpy() == pytest.approx(COMMAND[rows - rows % 2])


def test_rates_are_known_by_their_headings(tmp_path):
    known = {"a_rad": "w_rad_s"}
    found = recording(tmp_path / "l.csv", "time,a_rad,w_rad_s,u", T, ANGLE, np.sin(COMMAND), COMMAND)
    source = LoggedData(str(tmp_path / "l.csv"), known=known).load(None, None)
    assert source.signature.state_names == found.signature.state_names == ("a", "w")
    assert bool(source.training.x.isfinite().all())
    mapped = LoggedData(str(tmp_path / "l.csv"), {"q": "a_rad", "v": "w_rad_s"}, {"u": "u"}).recording(None)
    assert mapped.signature.state_units == ("rad", "rad/s")


def test_columns_with_a_clock_of_their_own_stand_at_the_times_of_the_first(tmp_path):
    later = T + 0.0037
    found = recording(
        tmp_path / "l.csv",
        "A_time [ms],A_x [m],B_time [ms],B_x [m],u",
        1e3 * T,
        ANGLE,
        1e3 * later,
        np.sin(later),
        COMMAND,
    )
    assert found.signature.state_names == ("A_x", "B_x")
    assert found.transitions.x[1:, 1].numpy() == pytest.approx(np.sin(T[1:-1]), abs=2e-5)


@pytest.mark.parametrize(
    ("unit", "turn"),
    [("rad", 2 * np.pi), ("deg", 360.0), ("-", 2 * np.pi), ("counts", 2.0**10), ("counts", 4000.0), ("ticks", 2.0**32)],
)
@pytest.mark.parametrize("start", [0.0, -0.5])
def test_an_angle_that_wraps_goes_on(tmp_path, unit, turn, start):
    whole = turn * ANGLE / 3
    whole = whole.round() if turn > 360 else whole
    inside = np.where(np.arange(ROWS) % 7, (whole - start * turn) % turn + start * turn, np.nan)
    found = recording(tmp_path / "l.csv", "time,q,u", T, inside, COMMAND, states={"q": {"name": "q", "unit": unit}})
    jumps = int((np.abs(np.diff(inside[np.isfinite(inside)])) > turn / 2).sum())
    assert note("log.unwrapped", state="q", turn=turn, times=jumps, counts=turn > 360) in found.findings
    x = found.transitions.x[:, 0].numpy()
    seen = np.isfinite(x)
    assert seen.sum() == np.isfinite(inside[1:-2]).sum() and np.ptp(x[seen] - whole[1:-2][seen]) < 1e-9 * turn


def test_a_noisy_compass_that_passes_north_to_and_fro_has_no_faults_and_keeps_those_that_it_has(tmp_path):
    heading = 400 * np.sin(1.5 * T) + np.random.default_rng(0).normal(0, 2.0, ROWS)
    heading[80] += 170
    found = recording(tmp_path / "l.csv", "time,q [deg],u", T, heading % 360, COMMAND)
    assert [each.values["count"] for each in found.findings if each.code == "log.spikes"] == [1]
    x = found.transitions.x[:, 0].numpy()
    assert np.isfinite(x).sum() == len(x) - 1
    assert np.degrees(np.nanmax(np.abs(np.diff(x)))) < 30


def test_a_row_that_is_off_by_a_turn_is_a_fault_of_the_counter_beside_an_encoder(tmp_path):
    way = np.degrees(ANGLE)
    way[100] += 360
    found = recording(tmp_path / "l.csv", "time,q [deg],u", T, way, COMMAND)
    assert [each.values["count"] for each in found.findings if each.code == "log.spikes"] == [1]
    assert np.flatnonzero(np.isnan(found.transitions.x[:, 0].numpy())).tolist() == [100]


@pytest.mark.parametrize("unit", ["-", "mm"])
@pytest.mark.parametrize("turn", [1000.0, 400.0, 1.0, 437.5, 628.3])
@pytest.mark.parametrize("start", [0.0, -0.5])
def test_a_place_that_jumps_by_its_range_goes_on_whatever_its_unit_and_range(tmp_path, unit, turn, start):
    for whole in (turn * ANGLE / 3, turn * (T + 0.2 * ANGLE)):  # to either side, or to one
        inside = (whole - start * turn) % turn + start * turn
        found = recording(tmp_path / "l.csv", f"time,q [{unit}],u", T, inside, COMMAND)
        assert [each.values["turn"] for each in found.findings if each.code == "log.unwrapped"] == [turn]
        assert np.ptp(found.transitions.x[:, 0].numpy() - whole[:-1]) < 1e-9 * turn


def test_what_is_emptied_or_set_anew_stays_and_is_told_with_the_setting_that_unwraps_it(tmp_path):
    level = np.zeros(ROWS)
    for k in range(1, ROWS):
        level[k] = level[k - 1] + 1.7 + 0.5 * np.sin(k / 30)
        level[k] = 0.0 if level[k] > 100 else level[k]
    moved = ANGLE + 20.0 * (np.arange(ROWS) > 150)
    for column, times, row in ((level, 6, 1 + (np.diff(level) < 0).argmax()), (moved, 1, 151)):
        found = recording(path := tmp_path / "l.csv", "time,x [mm],u", T, column, COMMAND)
        assert np.array_equal(found.transitions.x[:, 0].numpy(), column[:-1])
        (told,) = (each for each in found.findings if each.code == "log.jumps")
        assert (told.severity, told.values["times"], told.values["after"]) == ("weak", times, pytest.approx(T[row]))
        if times > 1:
            turned = LoggedData(str(path), states=told.values["states"], inputs=["u"]).recording(None)
            assert "log.unwrapped" in [each.code for each in turned.findings]
    found = recording(path, "time,x [rad/s],u", T, level, COMMAND)
    assert [each.values["states"] for each in found.findings if each.code == "log.jumps"] == [{}], "no turn of a rate"


LEVEL = np.interp(T, [0, 1.5, 1.8, 3.3, 3.6, 4], [0, 355, 2, 355, 1, 90])  # of a tank that is emptied


@pytest.mark.parametrize(
    "x", [ANGLE, LEVEL, LEVEL + 200, np.sign(COMMAND) * np.pi, 180 * COMMAND, np.clip(6 * COMMAND, -np.pi, np.pi)]
)
def test_what_moves_within_its_range_stays(tmp_path, x):
    found = recording(tmp_path / "l.csv", "time,q,u", T, x, COMMAND)
    assert "log.unwrapped" not in [each.code for each in found.findings]
    assert np.isin(found.transitions.x[:, 0].numpy(), x).all()


def _require_truth(found, rows=ROWS - 1):
    assert (found.signature.state_names, found.signature.input_names) == (("angle", "rate"), ("u",))
    assert found.transitions.dt == pytest.approx(0.01, rel=1e-3) and len(found.transitions) >= rows
    assert found.transitions.x[:30, 0].numpy() == pytest.approx(ANGLE[:30], abs=1e-4)


RATE = 12 * np.sin(3 * T)


@pytest.mark.parametrize(
    ("heading", "epoch", "per_second"),
    [
        ("FILETIME", 11_644_473_600, 1e7),
        ("Ticks", 62_135_596_800, 1e7),
        ("JD", 2_440_587.5 * 86400, 1 / 86400),
        ("Date", 25_569 * 86400, 1 / 86400),
        ("Date", 719_529 * 86400, 1 / 86400),
        ("ts", 0, 1e3),
    ],
)
def test_a_time_is_known_by_numbers_that_only_a_date_can_be(tmp_path, heading, epoch, per_second):
    stamps = (epoch + 1_741_944_413 + 60 * T) * per_second
    found = recording(tmp_path / "l.csv", f"{heading},angle,rate,u", stamps, ANGLE, RATE, COMMAND)
    assert found.transitions.dt == pytest.approx(0.6, rel=1e-2) and found.signature.state_names == ("angle", "rate")


def test_a_counter_of_ticks_that_overflows_is_the_time_where_the_period_is_given(tmp_path):
    ticks = (2**32 - 5_000_000 + 480_000 * np.arange(ROWS)) % 2**32
    _require_truth(recording(tmp_path / "l.csv", "ticks,angle,rate,u", ticks, ANGLE, RATE, COMMAND, dt=0.01))


@pytest.mark.parametrize(
    "order",
    [
        np.arange(ROWS)[::-1],
        np.r_[0:100, 200:300, 100:200, 300:ROWS],
        np.r_[0:50, 51, 50, 52:ROWS],
        np.r_[0:200, 190:ROWS],
    ],
)
def test_rows_that_came_late_or_twice_or_the_newest_first_are_put_in_order(tmp_path, order):
    columns = (column[order] for column in (T, ANGLE, RATE, COMMAND))
    found = recording(tmp_path / "l.csv", "time,angle,rate,u", *columns)
    _require_truth(found)
    assert "log.sorted" in {each.code for each in found.findings}


def test_a_clock_that_was_set_back_is_refused(tmp_path):
    with pytest.raises(LogError) as error:
        recording(tmp_path / "l.csv", "time,angle,rate,u", T - 0.503 * (T > 2), ANGLE, RATE, COMMAND)
    assert error.value.finding.code == "log.time_order"


@pytest.mark.parametrize("missing", [False, True])
def test_words_of_a_switch_are_an_input_also_where_some_are_missing(tmp_path, missing):
    words = ["" if missing and k % 50 == 7 else "ON" if c > 0 else "OFF" for k, c in enumerate(COMMAND)]
    rows = (f"{t:.2f};{a:.6f};{r:.6f};{u}" for t, a, r, u in zip(T, ANGLE, RATE, words, strict=True))
    found = of_lines(tmp_path / "l.csv", "time;angle;rate;u", *rows)
    u = found.transitions.u[:, 0].tolist()
    assert set(u) == {0.0, 1.0}
    if not missing:
        _require_truth(found)
        assert u == (COMMAND > 0)[:-1].tolist()


def test_commands_between_two_samples_and_sensors_that_take_turns_leave_the_period_of_the_samples(tmp_path):
    times = np.sort(np.concatenate([T, T + 0.003, T + 0.0005]))
    turn = np.tile([0, 2, 1], ROWS)
    angle, rate, command = (
        np.where(turn == k, np.repeat(v, 3), np.nan) for k, v in enumerate((ANGLE, 12 * np.sin(3 * T + 0.009), COMMAND))
    )
    found = recording(tmp_path / "l.csv", "time,angle,rate,u", times, angle, rate, command)
    assert found.transitions.dt == pytest.approx(0.01)
    x = found.transitions.x.numpy()
    assert np.isfinite(x).mean() > 0.95
    assert np.nanmedian(np.abs(np.diff(x[:, 0]) / 0.01 - x[:-1, 1])) < 0.4


def test_a_slower_clock_of_a_column_leaves_rows_without_it(tmp_path):
    cells = [f"{t:.3f},{a:.6f}" for t, a in zip(T, ANGLE, strict=True)]
    slow = [f",{t:.3f},{u:.4f}" for t, u in zip(T[::10], COMMAND[::10], strict=True)] + [",,"] * ROWS
    rows = (a + b for a, b in zip(cells, slow))
    found = of_lines(tmp_path / "l.csv", "time_angle,angle,time_u,u", *rows)
    assert found.transitions.u[:, 0].numpy() == pytest.approx(np.repeat(COMMAND[::10], 10)[:-1], abs=1e-4)


def test_what_jumps_with_an_input_is_no_state(tmp_path):
    command = np.where(np.arange(ROWS) // 15 % 2, 0.7, -0.4)
    push = 8 * command + np.sin(T)
    found = recording(tmp_path / "l.csv", "time,angle,rate,push,u", T, ANGLE, RATE, push, command)
    _require_truth(found)
    assert [each.values["why"] for each in found.findings if each.code == "log.left_out"] == ["direct"]


def test_of_two_rows_at_an_event_the_second_stays(tmp_path):
    command = np.where(np.arange(ROWS) // 10 % 2, 0.7, -0.4)
    events = np.flatnonzero(np.diff(command)) + 1
    rows = np.sort(np.r_[np.arange(ROWS), events])
    before = np.append(rows[1:] == rows[:-1], False)
    u = np.where(before, command[rows - 1], command[rows])
    found = recording(tmp_path / "l.csv", "time,angle,rate,u", T[rows], ANGLE[rows], RATE[rows], u)
    _require_truth(found)
    assert found.transitions.u[:, 0].numpy() == pytest.approx(command[:-1])


@pytest.mark.parametrize(
    ("headings", "names", "units"),
    [
        ('time;"angle, deg (S/N: 17)";"rate, deg/s (S/N: 18)";u', ("angle", "rate"), ("rad", "rad/s")),
        ("time;angle;der(angle);u", ("angle", "der_angle"), ("-", "-")),
        ("time;x['angle'];x['rate'];u", ("x_angle", "x_rate"), ("-", "-")),
    ],
)
def test_what_stands_in_brackets_and_is_no_unit_belongs_to_the_name(tmp_path, headings, names, units):
    rows = (";".join(map(str, row)) for row in zip(T, ANGLE, RATE, COMMAND, strict=True))
    signature = of_lines(tmp_path / "l.csv", headings, *rows).signature
    assert (signature.state_names, signature.state_units) == (names, units)


@pytest.mark.parametrize("apart", [0.0, 0.002])
def test_rows_of_a_time_a_name_and_a_value_have_a_column_a_name(tmp_path, apart):
    rows = (
        f"{t + k * apart:.4f},{name},{value:.6f}"
        for t, *values in zip(T, ANGLE, RATE, COMMAND, strict=True)
        for k, (name, value) in enumerate(zip(("angle", "rate", "u"), values, strict=True))
    )
    found = of_lines(tmp_path / "l.csv", "time,signal,value", *rows)
    if not apart:
        _require_truth(found)
    assert (found.signature.state_names, found.signature.input_names) == (("angle", "rate"), ("u",))
    assert found.transitions.dt == pytest.approx(0.01) and len(found.transitions) >= ROWS - 3
    assert found.transitions.x.isfinite().double().mean() > 0.95
