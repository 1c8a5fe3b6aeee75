import torch
from tensordict import TensorDict

from dynasindy.dyna.callback import Cost, Episode
from dynasindy.dyna.progress import ProgressBar
from dynasindy.planning import ModelError


def test_the_bar_shows_return_model_error_steps_and_time_left(capsys):
    bar = ProgressBar(2)
    rollout = TensorDict({"next": {"reward": torch.full((4, 1), -1.5)}}, [4])
    bar.fitted(None, rollout, Cost(200))
    bar.bar.refresh()
    bar.episode(Episode(1, rollout, ModelError(0.0123, 0.0, torch.zeros(0)), True), Cost(600))
    bar.bar.refresh()
    bar.close()
    shown = capsys.readouterr().err
    for words in ("1/2", "return -6.0", "open-loop reward error 0.0123", "real steps 600", "episode"):
        assert words in shown


def test_the_bar_is_shown_unless_it_is_told_not_to(capsys):
    for shown in ({}, {"shown": False}):
        ProgressBar(2, **shown).close()
        assert bool(capsys.readouterr().err) == (not shown)
