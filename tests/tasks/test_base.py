import pytest

from dynasindy.systems import Tras
from dynasindy.tasks import Step, Tracking


def test_an_episode_has_at_least_one_step():
    with pytest.raises(ValueError, match="max_steps"):
        Tracking(Tras().signature, Step([[0.0, 0.0]]), max_steps=0)
    task = Tracking(Tras().signature, Step([[0.0, 0.0]]), max_steps=1)
    assert task.max_steps == 1 and task.signature == Tras().signature
