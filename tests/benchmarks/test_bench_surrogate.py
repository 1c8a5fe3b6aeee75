"""The stand-in's log is one that a user could have written, and the command identifies it by itself."""

import math
from pathlib import Path

import pytest
import torch
from benchmark import parse
from benchmarks import bench_surrogate
from benchmarks.bench_surrogate import Rig, record_closed_loop, write_log

from dynasindy.safe_io import read_rows
from dynasindy.systems import Tras

RESULTS = Path(__file__).parents[2] / "docs" / "results" / "standin.csv"


@pytest.mark.slow
def test_the_command_identifies_a_log_and_judges_all_three_methods(tmp_path, monkeypatch):
    quick, command = "world_model.refinement.method=trajectory", bench_surrogate.run_command
    monkeypatch.setattr(
        bench_surrogate, "run_command", lambda name, words, *more: command(name, [*words, quick], *more)
    )
    monkeypatch.setattr(bench_surrogate, "SECONDS", 30.0)
    monkeypatch.setattr(bench_surrogate, "CASES", {"still": 0.0})
    out = tmp_path / "standin.csv"
    bench_surrogate.main(parse("bench_surrogate", ["--logs", "1", "--out", str(out)]))
    ours, linear, held = read_rows(out)
    assert list(ours) == bench_surrogate.COLUMNS
    for state in bench_surrogate.TARGETS:
        assert float(ours[state]) < float(linear[state]) < float(held[state])
    assert float(ours["delay_ms"]) == pytest.approx(10.0, abs=5.0)  # within half a sample


def test_published_rows_are_of_all_three_methods_on_each_log():
    rows = read_rows(RESULTS)
    logs = {(row["case"], row["log"]) for row in rows}
    assert len(rows) == 3 * len(logs)
    for key in logs:
        ours, linear, held = [row for row in rows if (row["case"], row["log"]) == key]
        for state in bench_surrogate.TARGETS:
            assert float(ours[state]) < float(linear[state]) < float(held[state])


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


def test_a_log_has_no_rates_angles_in_steps_and_inputs_that_act_a_sample_late(tmp_path):
    measured, commands = record_closed_loop(0.3, 2)
    assert measured.shape == (30, 2, 6) and bool(measured[..., 2:4].isnan().all())
    steps = measured[..., :2] / 0.0015
    assert torch.allclose(steps, steps.round(), atol=1e-6)
    # From rest, the first command reaches the motor after one sample: speeds are noise until then.
    speeds = measured[:, :, 4:].mean(1)
    assert float(commands[0].abs().min()) > 0.01 and float(speeds[:2].abs().max()) < 60 < float(speeds[5].abs().max())
    write_log(tmp_path / "log.csv", measured[:, 1], commands[:, 1])
    lines = (tmp_path / "log.csv").read_text().splitlines()
    assert lines[0] == "time,alpha_a,alpha_p,omega_a,omega_p,u_a,u_p" and len(lines) == 31
    assert float(lines[11].split(",")[5]) == pytest.approx(float(commands[10, 1, 0]), rel=1e-6)
