import numpy as np
import pytest

from dynasindy.viz.report.document import Verdict
from dynasindy.viz.report.model_verdicts import coefficients_agree, first_model_agrees, hyperparameters_agree
from dynasindy.viz.report.model_verdicts import learning_agrees as learning

STATES = ("alpha_a", "alpha_p", "Omega_a", "Omega_p", "omega_a", "omega_p")


def test_settings_that_are_not_the_papers_are_named():
    found = hyperparameters_agree("xi", 11, ["agent.tau"])
    assert found.verdict is Verdict.SHORT and found.ours == "10 of them in `experiment=paper`, not `agent.tau`"


def test_a_missing_or_a_false_function_is_told():
    truth = {"y": {"u": 2.0, "x": -1.0}}
    assert coefficients_agree("xi", truth, truth).verdict is Verdict.AS
    missing = coefficients_agree("xi", {"y": {"u": 2.01}}, truth)
    assert (
        missing.verdict is Verdict.SHORT and missing.ours == "1 of them found, the worst 0.5 % off; 0 functions besides"
    )
    false = coefficients_agree("xi", {"y": truth["y"] | {"1": 0.002}}, truth)
    assert false.verdict is Verdict.SHORT and false.ours.endswith("the largest 0.001 of the largest in its equation")


def test_rotors_and_beam_are_judged_apart():
    well = first_model_agrees("xi", dict.fromkeys(STATES, 0.1) | {"omega_a": 9.0})
    assert [finding.verdict for finding in well] == [Verdict.SHORT, Verdict.SHORT]
    paper = first_model_agrees("xi", dict.fromkeys(STATES, 9.0) | {"omega_a": 0.1, "omega_p": 0.1})
    assert [finding.verdict for finding in paper] == [Verdict.AS, Verdict.AS]


def test_a_model_that_was_never_trusted_is_called_so():
    of = (np.array([1.0, 2.0]), np.array([46.0, 71.0]))
    assert learning("xi", *of, np.array([]), 0.05).ours == (
        "46 per period in episode 1, 71 per period in episode 2, at worst 71 per period in episode 2; trusted below "
        "0.05 on held-out windows, never trusted"
    )
    assert learning("xi", *of, np.array([2.0]), 0.05).ours.endswith(", trusted from episode 2")


@pytest.mark.parametrize(
    ("error", "said"), [(0.34, "0.34 per period"), (np.inf, "the model ran away"), (np.nan, "the model ran away")]
)
def test_the_episode_that_keeps_a_course_from_being_small_is_named(error, said):
    found = learning("xi", np.arange(1.0, 5.0), np.array([0.02, 0.01, error, 0.03]), np.array([1.0]), 0.05)
    assert f", at worst {said} in episode 3; " in found.ours and found.verdict is Verdict.SHORT
