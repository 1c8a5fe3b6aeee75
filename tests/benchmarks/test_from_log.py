"""The log of the benchmark is what a bench would write, and flights are scored by hand."""

import csv

import numpy as np
import pytest
from benchmarks.from_log import DT, TARGETS, simulate_targets, write_log

from dynasindy import Controller
from dynasindy.agents.networks import actor
from dynasindy.control.controller import ControlSetup
from dynasindy.evaluation.scenarios import step_references
from dynasindy.systems import Tras
from dynasindy.tasks import RandomStep, Tracking


def test_the_log_holds_what_the_bench_measures_and_nothing_else(tmp_path):
    write_log(tmp_path / "log.csv", 0)
    with (tmp_path / "log.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head == [
        "time [s]",
        "alpha_a [rad]",
        "alpha_p [rad]",
        "omega_a [rpm]",
        "omega_p [rpm]",
        "u_a [-]",
        "u_p [-]",
    ]
    values = np.array(rows, dtype=float)
    counts = values[:, 1:3] / (2 * np.pi / 4096)
    np.testing.assert_allclose(counts, counts.round(), atol=1e-4)
    np.testing.assert_allclose(values[:, 0], DT * np.arange(1000), atol=1e-9)  # every sample, at the stops too
    assert np.abs(np.diff(values[:, 1:3], axis=0)).max() < 0.1  # and no jump between two of them


class Idle:
    """A controller that gives no input."""

    def act(self, y, r):
        assert len(y) == 6 and len(r) == 2
        return np.zeros(2)


@pytest.mark.slow
def test_errors_are_those_of_the_plant_at_the_end():
    """Without inputs the beam comes to rest, and the error is the distance of the target from there."""
    task = Tracking(Tras().signature, RandomStep([-0.5, -0.5], [0.5, 0.4]))
    controller = Controller(actor(task.n_o, 2, (4,)), ControlSetup(task, 0.05))
    errors = simulate_targets(controller, [Idle() for _ in range(TARGETS)], 0)
    targets = step_references((-0.5, -0.5), (0.5, 0.4), TARGETS).targets.numpy()
    np.testing.assert_allclose(errors[:, 0], np.abs(targets[:, 0]), atol=1e-3)
    # One rest explains all errors in pitch: |target - rest|.
    low = targets[:, 1].min()
    rest = low - errors[targets[:, 1].argmin(), 1]
    candidates = [rest, low + errors[targets[:, 1].argmin(), 1]]
    assert any(np.allclose(errors[:, 1], np.abs(targets[:, 1] - r), atol=5e-2) for r in candidates)
