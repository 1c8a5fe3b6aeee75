"""The textbook systems are the published ones, and their noisy recordings give them back."""

import pytest
import torch
from benchmarks import textbook
from benchmarks.rivals import smoothed_rows, weak_rows

from dynasindy.data.simulated import disturb

TRUE = {
    "van_der_pol": {("y", "x"): 1, ("x", "y"): -1, ("y", "y"): 1, ("x^2 y", "y"): -1, ("u", "y"): 3},
    "lorenz": {
        ("x", "x"): -10, ("y", "x"): 10, ("u", "x"): 50, ("x", "y"): 28, ("y", "y"): -1, ("x z", "y"): -1,
        ("x y", "z"): 1, ("z", "z"): -8 / 3,
    },
}  # fmt: skip


@pytest.mark.parametrize("name", TRUE)
def test_the_systems_are_the_published_ones(name):
    case = textbook.CASES[name]
    names, states, truth = case.library().names, case.plant.signature.state_names, case.truth()
    found = {(names[k], states[i]): float(truth[k, i]) for k, i in truth.nonzero().tolist()}
    assert found == pytest.approx(TRUE[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", TRUE)
def test_ten_percent_of_noise_leave_the_terms_and_the_bound(name):
    rows = {row["measure"]: row["value"] for row in textbook.measure(textbook.CASES[name], 1)}
    for level in (1, 10):
        assert rows[f"noise {level} %: seeds with all terms and 0 false"] == "1 of 1"
        median = rows[f"noise {level} %: rms error / Cramer-Rao bound, median and worst seed"].partition(",")[0]
        assert 0.2 < float(median) < 2


def test_rows_for_pysindy_obey_the_equations():
    case = textbook.CASES["van_der_pol"]
    clean, truth = case.clean(1)[0], case.truth()
    smoothed = smoothed_rows(case.library(), clean, 9)  # it rounds off where the input jumps
    for rows, limit in ((smoothed, 0.2), (weak_rows(case.library(), disturb(clean, 1e-4, 0)), 0.05)):
        error = (rows[1] - rows[0] @ truth).norm(dim=0) / rows[1].norm(dim=0)
        assert bool((error < limit).all()), error
    assert torch.equal(smoothed_rows(case.library(), clean, 0)[0], case.library()(clean.x, clean.u))
