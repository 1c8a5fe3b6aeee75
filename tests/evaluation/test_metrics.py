"""Tracking metrics against closed-form step responses and hand-made records."""

import math

import pytest
import torch

from dynasindy.evaluation import metrics
from dynasindy.evaluation.metrics import (
    MIN_STEP,
    TRACKING,
    steady_seconds,
    tracking_metrics,
)

DT = 0.001
TIME = torch.arange(0, 20, DT, dtype=torch.float64)


def measure(y: torch.Tensor, r: torch.Tensor, u: torch.Tensor | None = None) -> dict[str, torch.Tensor]:
    return tracking_metrics(TIME, y, r, torch.zeros_like(y) if u is None else u)


def test_what_a_sensor_cannot_tell_from_the_target_has_settled() -> None:
    # A ripple of .01 about a target of .1 stays within 3 standard deviations of a sensor's .004, and not of its .003.
    y = (0.1 * (1 - torch.exp(-2 * TIME)) + 0.01 * torch.sin(9 * TIME)).unsqueeze(-1)
    r, u = torch.full_like(y, 0.1), torch.zeros_like(y)
    times = [
        tracking_metrics(TIME, y, r, u, noise=torch.tensor([std]))["settling_time"].item() for std in (0.003, 0.004)
    ]
    assert times[0] == math.inf and 0.5 * math.log(0.1 / 0.022) <= times[1] <= 0.5 * math.log(0.1 / 0.002)


def test_a_gust_after_the_step_is_no_part_of_it() -> None:
    """y = 1 - exp(-t) is within 5 % after ln 20 s = 3 s; a gust from 12 to 15 s pushes it by 0.4."""
    time = 0.01 * torch.arange(3000, dtype=torch.float64)
    y = (1 - torch.exp(-time)).reshape(1, -1, 1)
    pushed = y + 0.4 * ((time >= 12) & (time < 15)).double().reshape(1, -1, 1)
    r, u = torch.ones_like(y), torch.zeros(1, 3000, 1)
    found = tracking_metrics(time, pushed, r, u, until=12.0)
    assert found["settling_time"].item() == pytest.approx(math.log(20), abs=0.02)
    assert found["overshoot"].item() == 0.0
    polluted = tracking_metrics(time, pushed, r, u)
    assert polluted["settling_time"].item() == pytest.approx(15.0, abs=0.02) and polluted["overshoot"].item() > 39
    # Errors are of the whole record, and what disturbs from the start on is part of the step.
    assert torch.equal(found["rmse"], polluted["rmse"])
    always = tracking_metrics(time, pushed, r, u, until=0.0)
    assert torch.equal(always["settling_time"], polluted["settling_time"])


def test_step_metrics_are_nan_where_there_is_no_step() -> None:
    still = torch.zeros(len(TIME), 1, dtype=torch.float64)
    moving = 0.35 * torch.sin(TIME).unsqueeze(-1)
    for reference in (still + 0.5 * MIN_STEP, moving):
        metrics = measure(still, reference)
        assert all(metrics[name].isnan() for name in ("overshoot", "rise_time", "settling_time"))
        assert all(metrics[name].isfinite() for name in TRACKING)


def test_batched_equals_row_by_row() -> None:
    generator = torch.Generator().manual_seed(3)
    y = torch.rand(2, 3, len(TIME), 2, dtype=torch.float64, generator=generator)
    r = torch.rand(2, 3, 1, 2, dtype=torch.float64, generator=generator).expand_as(y)
    batched = measure(y, r, y)
    for i in range(2):
        for j in range(3):
            for name, value in measure(y[i, j], r[i, j], y[i, j]).items():
                torch.testing.assert_close(batched[name][i, j], value, equal_nan=True)


def record(y: list[float], target: float, dt: float = 0.5, start: float = 0.0) -> tuple[torch.Tensor, ...]:
    time = start + dt * torch.arange(len(y), dtype=torch.float64)
    column = torch.tensor(y, dtype=torch.float64).unsqueeze(-1)
    return time, column, torch.full_like(column, target)


@pytest.mark.parametrize(
    ("dt", "samples", "seconds"),
    [(0.05, 400, 5.0), (0.01, 10_000, 5.0), (2.0, 400, 40.0), (0.05, 100, 1.25), (2.0, 10, 5.0), (10.0, 2, 10.0)],
)
def test_the_steady_state_is_of_five_seconds_or_twenty_samples_or_a_quarter(dt: float, samples: int, seconds: float):
    assert steady_seconds(dt, samples) == pytest.approx(seconds)


def test_a_step_is_a_step_by_the_size_of_the_box() -> None:
    time, y, r = record([0.0, 0.001, 0.002, 0.002], 0.002)
    u = torch.zeros_like(y)
    assert tracking_metrics(time, y, r, u)["rise_time"].isnan().all()
    assert tracking_metrics(time, y, r, u, torch.tensor([0.01]))["rise_time"].isfinite().all()


def test_every_figure_of_a_short_record_by_hand() -> None:
    time, y, r = record([0.0, 0.05, 0.3, 0.9, 1.2, 0.97, 1.04, 1.0], 1.0, start=7.0)
    u = torch.tensor([0.0, 0.5, -0.5, 1.0, 1.0, 0.0, 0.0, 0.0]).double().unsqueeze(-1)
    found = {name: value.item() for name, value in tracking_metrics(time, y, r, u).items()}
    errors = [1.0, 0.95, 0.7, 0.1, 0.2, 0.03, 0.04, 0.0]
    assert found["rmse"] == pytest.approx((sum(e * e for e in errors) / 8) ** 0.5)
    assert found["mean_abs_error"] == pytest.approx(sum(errors) / 8)
    assert found["steady_state_error"] == pytest.approx((0.04 + 0.0) / 2)  # the last quarter of a short record
    assert found["overshoot"] == pytest.approx(20.0)
    # 10 % a fifth of the way from 0.05 to 0.3 (t = 0.6 s), 90 % at t = 1.5 s.
    assert found["rise_time"] == pytest.approx(0.9)
    assert found["settling_time"] == pytest.approx(2.5)  # since the step, not since time zero
    assert found["control_effort"] == pytest.approx((0.25 + 0.25 + 1 + 1) / 8)
    assert found["control_variation"] == pytest.approx((0.5 + 1.0 + 1.5 + 0.0 + 1.0) / 7 / 0.5)


def times(time: torch.Tensor, y: torch.Tensor, r: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return rise and settling time."""
    found = tracking_metrics(time, y, r, torch.zeros_like(y))
    return found["rise_time"], found["settling_time"]


def test_settling_is_at_the_band_and_never_if_the_last_sample_is_outside(monkeypatch) -> None:
    time, y, r = record([0.0, 0.5, 0.75, 1.25, 1.0], 1.0)
    monkeypatch.setattr(metrics, "SETTLING_BAND", 0.25)
    assert times(time, y, r)[1].item() == 1.0  # 0.75 and 1.25 are still inside
    monkeypatch.setattr(metrics, "SETTLING_BAND", 0.24)
    assert times(time, y, r)[1].item() == 2.0
    assert times(time[:4], y[:4], r[:4])[1].isinf()
    assert times(time, r, r)[1].isnan()  # no step at all


def test_what_crosses_the_band_in_the_steady_state_has_not_settled() -> None:
    # Of 20 s at 20 Hz, the last 5 s count as steady state: from 15 s on, as sample 300 is the first of 100.
    time = 0.05 * torch.arange(400).double()
    target = torch.ones(400, 1).double()
    for last, settled in ((299, 15.0), (300, math.inf), (398, math.inf), (399, math.inf)):
        y = torch.ones(400, 1).double()
        y[: last + 1] = 0.5
        y[0] = 0.0
        assert times(time, y, target)[1].item() == pytest.approx(settled)
    swinging = 1 + torch.cos(2 * time).unsqueeze(-1) * torch.where(time > 0, 1.0, -1.0).unsqueeze(-1)
    inside = time[((swinging[:, 0] - 1).abs() <= 0.05).nonzero()[-1]].item()
    end = round(inside / 0.05) + 1  # the record ends at a sample within the band, which it only crosses
    assert times(time[:end], swinging[:end], target[:end])[1].item() == math.inf


def test_rise_counts_from_the_first_crossings_between_samples(monkeypatch) -> None:
    time, y, r = record([0.0, 0.4, 0.0, 0.8, 0.6, 1.0], 1.0)
    monkeypatch.setattr(metrics, "RISE", (0.2, 0.7))
    assert times(time, y, r)[0].item() == pytest.approx(0.5 * (2 + 0.7 / 0.8) - 0.25)
    assert times(time[:3], y[:3], r[:3])[0].isinf()  # it began and never arrived
