import pytest

from dynasindy.dyna.run import Evaluating, report
from dynasindy.evaluation.scenarios import Scenario


def test_an_evaluation_happens_at_least_sometimes():
    with pytest.raises(ValueError, match=r"evaluation\.every"):
        Evaluating(Scenario("step"), every=0)


def test_the_report_says_equations_metrics_costs_and_folder(tmp_path):
    axis = dict.fromkeys(
        ("rmse", "mean_abs_error", "steady_state_error", "overshoot", "rise_time", "settling_time", "settled"), 0.25
    )
    evaluation = {f"{name}/alpha_a": value for name, value in axis.items()}
    evaluation |= {"control_effort/u_a": 0.1, "control_variation/u_a": 0.2, "return": -12.0, "stop_share": 0.0}
    cost = {"real_steps": 600, "plant_seconds": 30, "imagined_transitions": 8000, "updates": 40, "wall_seconds": 12.3}
    cost["evaluation_steps"] = 25600
    text = report(
        {
            "cost": cost,
            "equations": ["Omega_p' = -0.414 Omega_p"],
            "scenario": "step",
            "evaluation": evaluation,
            "untrained": {"return": -99.0},
        },
        tmp_path,
    )
    for words in (
        "Omega_p' = -0.414 Omega_p",
        "-99.0",
        "-12",
        "600 real steps = 30 s",
        "8000 imagined",
        "25600 real steps of evaluation",
        str(tmp_path),
    ):
        assert words in text
