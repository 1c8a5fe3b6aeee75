"""Which runs leave a usable result."""

import re
from dataclasses import asdict

import pytest

from dynasindy.dyna.verdict import judge


def metrics(untrained, trained):
    return {"scenario": "step", "untrained": {"return": untrained}, "evaluation": {"return": trained}}


@pytest.mark.parametrize(
    ("untrained", "trained", "usable", "words"),
    [
        (-250.0, -10.0, True, "is better than the untrained one: its return in scenario 'step' is -10, .* -250."),
        (-10.0, -250.0, False, "no usable result: the trained policy is worse than .* is -250, .* -10;"),
        (-10.0, -10.0, False, "no usable result: the trained policy is no better than"),
        (-10.0, None, False, "no usable result: the return in scenario 'step' is not finite"),
        (None, -10.0, False, "not finite"),
        (1.0, 2.0, True, "better"),
    ],
)
def test_the_trained_policy_has_to_be_better_than_the_untrained_one(untrained, trained, usable, words):
    verdict = judge(metrics(untrained, trained))
    assert verdict.usable is usable
    assert re.search(words, verdict.sentence)
    assert "\n" not in verdict.sentence
    assert asdict(verdict) == {"usable": usable, "sentence": verdict.sentence}
