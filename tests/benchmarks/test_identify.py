"""The identification benchmark at small size: what it counts is right, and its easy cases hold."""

import numpy as np
import pytest
import torch
from benchmark import parse
from benchmarks import identify, pysindy_regression
from benchmarks.identify import TEXTBOOK, cramer_rao
from benchmarks.pysindy_regression import best_threshold, smoothed_rows, weak_rows

from dynasindy.safe_io import read_rows
from dynasindy.sindy.library import CONSTANT, Library, variable
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions


def test_the_true_table_is_the_published_one():
    truth = identify.true_table()
    assert int((truth != 0).sum()) == 19
    assert float(truth.abs().max()) == pytest.approx(3.7e4)


def test_rows_without_noise_give_the_plant_and_those_of_other_cases_stay_in_the_file(tmp_path):
    path = tmp_path / "table.csv"
    for names in (["xi_10s", "xi_control"], ["xi_control"]):
        options = parse("identify", ["--seeds", "1", "--out", str(path), "--only", *names])
        identify.main(options)
    rows = read_rows(path)
    assert tuple(rows[0]) == identify.COLUMNS
    values = {(row["case"], row["measure"].partition(",")[0]): row["value"] for row in rows}
    assert len(values) == len(rows) == 6
    for case, goal in (("xi_10s", 1e-6), ("xi_control", 1e-4)):
        assert values[case, "seeds with 19 of 19 terms and 0 false"] == "1 of 1"
        assert float(values[case, "worst relative coefficient error"]) < goal


def test_the_slope_of_a_line_is_known_as_well_as_least_squares_can():
    # y' = 3: a line through 121 samples whose start is unknown; the error of its slope is sigma / |t - mean of t|.
    library = Library(Signature(("y",), ("-",), ("u",), (1.0,)), [CONSTANT, variable("y")])
    time = 0.1 * np.arange(121)
    y = torch.from_numpy(1 + 3 * time)[:, None]
    data = Transitions.from_trajectory(y, torch.zeros(120, 1).double(), 0.1)
    bound = cramer_rao(library, torch.tensor([[3.0], [0.0]]).double(), data, torch.tensor([0.2]).double())
    assert bound.tolist() == pytest.approx([0.2 / np.linalg.norm(time - time.mean())], rel=1e-6)


def test_the_best_threshold_is_the_one_with_most_true_and_fewest_false_terms_in_the_units_of_the_data(monkeypatch):
    monkeypatch.setattr(
        pysindy_regression, "SCALED_THRESHOLDS", (1e-6, 0.1, 0.99)
    )  # keeps all; only the true ones; none
    generator = torch.Generator().manual_seed(0)
    theta = torch.rand(200, 4, generator=generator, dtype=torch.float64) - 0.5
    truth = torch.tensor([[1.0, 0.0], [0.5, 3000.0], [0.0, 0.0], [0.0, 4000.0]], dtype=torch.float64)
    noise = torch.tensor([1e-2, 30.0]) * torch.randn(200, 2, generator=generator, dtype=torch.float64)
    worth, words, scores = best_threshold("rows", [(theta, theta @ truth + noise)], truth, scaled=True)
    assert scores[0][:2] == (4, 0) and scores[0][2] < 0.05 and worth == 4
    assert words.startswith("threshold=0.1,") and words.endswith("rows")


TRUE = {
    "van_der_pol": {("y", "x"): 1, ("x", "y"): -1, ("y", "y"): 1, ("x^2 y", "y"): -1, ("u", "y"): 3},
    "lorenz": {
        ("x", "x"): -10, ("y", "x"): 10, ("u", "x"): 50, ("x", "y"): 28, ("y", "y"): -1, ("x z", "y"): -1,
        ("x y", "z"): 1, ("z", "z"): -8 / 3,
    },
}  # fmt: skip


@pytest.mark.parametrize("name", TRUE)
def test_the_systems_are_the_published_ones(name):
    case = TEXTBOOK[name]
    names, states, truth = case.library().names, case.plant.signature.state_names, case.truth()
    found = {(names[k], states[i]): float(truth[k, i]) for k, i in truth.nonzero().tolist()}
    assert found == pytest.approx(TRUE[name])


def test_rows_for_pysindy_obey_the_equations():
    case = TEXTBOOK["van_der_pol"]
    clean, truth = case.clean(1)[0], case.truth()
    smoothed = smoothed_rows(case.library(), clean, 9)  # it rounds off where the input jumps
    for rows, limit in ((smoothed, 0.2), (weak_rows(case.library(), clean.disturbed(1e-4, 0)), 0.05)):
        error = (rows[1] - rows[0] @ truth).norm(dim=0) / rows[1].norm(dim=0)
        assert bool((error < limit).all()), error
    assert torch.equal(smoothed_rows(case.library(), clean, 0)[0], case.library()(clean.x, clean.u))
