import json

import torch
from tensordict import TensorDict

from dynasindy.dyna.callback import Cost, Episode, Place, RunProgress
from dynasindy.planning import ModelError, Planned
from dynasindy.progress import listening


def test_a_place_that_is_restored_is_the_same_place_and_the_same_cost():
    here = Place(True, True, 7, Cost(3000, 20, 5))
    other = Place()
    other.load_state_dict(json.loads(json.dumps(here.state_dict())))
    assert other == here and isinstance(other.cost, Cost)
    other.cost.add(Planned(imagined=1, updates=2))
    assert (other.cost.imagined, other.cost.updates) == (21, 7) and here.cost.updates == 5


def test_a_run_tells_its_return_model_error_and_steps():
    heard = []
    rollout = TensorDict({"next": {"reward": torch.full((4, 1), -1.5)}}, [4])
    with listening(heard.append):
        told = RunProgress(2)
        told.fitted(None, rollout, Cost(200))
        told.episode(Episode(1, rollout, ModelError(0.0123, 0.0, torch.zeros(0)), True), Cost(600))
    assert [(one.done, one.total, one.outer) for one in heard] == [(0, 2, True), (0, 2, True), (1, 2, True)]
    assert heard[1].note == "real steps 200"
    assert all(part in heard[2].note for part in ("return -6.0", "error 0.0123", "steps 600"))


def test_a_resumed_run_counts_on():
    heard = []
    with listening(heard.append):
        RunProgress(5, Place(True, True, 3))
    assert heard[0].count() == "3 of 5 episodes"
