import torch
from tensordict import TensorDict

from dynasindy.dyna.callback import Cost, Episode, Place
from dynasindy.dyna.progress import Progress
from dynasindy.planning import ModelError
from dynasindy.told import hearing


def test_a_run_tells_its_return_model_error_and_steps():
    heard = []
    rollout = TensorDict({"next": {"reward": torch.full((4, 1), -1.5)}}, [4])
    with hearing(heard.append):
        told = Progress(2)
        told.fitted(None, rollout, Cost(200))
        told.episode(Episode(1, rollout, ModelError(0.0123, 0.0, torch.zeros(0)), True), Cost(600))
    assert [(one.done, one.total, one.around) for one in heard] == [(0, 2, True), (0, 2, True), (1, 2, True)]
    assert heard[1].words == "real steps 200"
    assert heard[2].words == "return -6.0, open-loop reward error 0.0123, real steps 600"


def test_a_resumed_run_counts_on():
    heard = []
    with hearing(heard.append):
        Progress(5, Place(True, True, 3))
    assert heard[0].counted() == "3 of 5 episodes"
