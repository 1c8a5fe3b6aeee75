"""Which episode is drawn: chosen by where it begins alone, and counted among the others."""

import pytest
import torch
from tensordict import TensorDict

from dynasindy.evaluation.scenarios import Evaluation
from dynasindy.evaluation.tracking_criteria import representative_episode
from dynasindy.systems import Signature

SIGNATURE = Signature(("a", "b"), ("m", "rad"), ("u",), (1.0, 1.0))


def evaluation(starts, references, boxes=(), columns=(0, 1), rewards=None) -> Evaluation:
    """Return flights that stay where they begin, `(episodes, 3)`."""
    x = torch.tensor(starts).unsqueeze(1).expand(-1, 3, -1)
    r = torch.tensor(references).unsqueeze(1).expand(-1, 3, -1)
    paid = torch.zeros(len(starts), 3, 1) if rewards is None else torch.tensor(rewards).unsqueeze(-1)
    rows = {"state": x, "reference": r, "action": torch.zeros(len(starts), 3, 1), "next": {"reward": paid}}
    return Evaluation("s", SIGNATURE, columns, torch.arange(3.0), TensorDict(rows, x.shape[:2]), {}, boxes=boxes)


def test_where_all_begin_alike_it_is_the_first_whatever_came_of_it() -> None:
    found = representative_episode(evaluation([[0.0, 0.0]] * 4, [[0.5, 0.0], [0.1, 0.0], [0.9, 0.0], [0.2, 0.3]]))
    assert found.row == 0
    # 0.1 and 0.3, the larger one of 0.2 and 0.3, are less than 0.5.
    assert found.words == "episode 1 of 4, the same for every controller; 2 others have a smaller error"


@pytest.mark.parametrize(("boxes", "row"), [((), 2), ((1.0, 10.0), 1)])
def test_of_different_beginnings_it_is_the_farthest_in_boxes(boxes, row) -> None:
    found = representative_episode(evaluation([[0.1, 0.1], [-0.6, 0.0], [0.0, 3.0]], [[0.0, 0.0]] * 3, boxes))
    assert found.row == row
    assert found.words.startswith(f"episode {row + 1} of 3, the one that starts farthest from its target; 2 others")


def test_without_references_it_is_the_one_that_earns_least_at_first() -> None:
    rewards = [[-1.0, 0.0, 0.0], [-5.0, 4.0, 4.0], [-2.0, 0.0, 0.0]]
    found = representative_episode(
        evaluation([[0.0, 1.0], [1.0, 0.0], [2.0, 0.0]], [[0.0]] * 3, columns=(), rewards=rewards)
    )
    assert (found.row, found.words.partition("; ")[2]) == (1, "0 others earn more")


def test_of_a_single_episode_nothing_is_said() -> None:
    assert representative_episode(evaluation([[0.0, 0.0]], [[0.5, 0.0]])).words == ""
