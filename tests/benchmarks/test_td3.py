"""The benchmark times what it says."""

import csv

import pytest
import torch
from benchmark import parse
from benchmarks import td3
from benchmarks.td3 import N_OBS, N_U, Size
from torch.utils.flop_counter import FlopCounterMode

from dynasindy.agents import TD3

SIZE = Size("tiny", (12, 8), 16, 10)


@pytest.fixture
def batch(monkeypatch):
    monkeypatch.setattr(td3, "REPLAY_ROWS", (50, 100))
    return td3.filled_replay(SIZE).sample()


def flops(step):
    with FlopCounterMode(display=False) as counter:
        step()
        step()
    return counter.get_total_flops()


def test_floor_has_the_multiplications_of_our_update_and_of_no_other(batch):
    agent = TD3(N_OBS, N_U, hidden=SIZE.hidden, machine_code=False)
    floor = flops(td3.matrix_products(SIZE))
    assert flops(lambda: agent.update(batch)) == floor
    assert flops(td3.stable_baselines3_update(SIZE, batch)) >= floor
    assert flops(td3.torchrl_update(SIZE, batch)) > floor


@pytest.mark.parametrize("make", [td3.torchrl_update, td3.stable_baselines3_update])
def test_rivals_learn(make, batch, monkeypatch):
    steps = []
    original = torch.optim.Adam.step
    monkeypatch.setattr(torch.optim.Adam, "step", lambda self, *a: steps.append(self) or original(self, *a))
    update = make(SIZE, batch)
    for _ in range(4):
        update()
    assert len(steps) == 6  # the critics four times, the actor twice
    assert len(set(map(id, steps))) == 2


def test_a_call_of_the_best_rival_takes_ten_fused_steps(batch, monkeypatch):
    steps = []
    original = torch.optim.Adam.step
    monkeypatch.setattr(torch.optim.Adam, "step", lambda self, *a: steps.append(self) or original(self, *a))
    td3.stable_baselines3_update(SIZE, batch, 10, fused=True)()
    assert len(steps) == 15 and all(one.defaults["fused"] for one in steps)
    steps.clear()
    td3.stable_baselines3_update(SIZE, batch)()
    assert not any(one.defaults["fused"] for one in steps)


def test_main_writes_a_row_per_contender_and_size(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(td3, "SIZES", (SIZE,))
    monkeypatch.setattr(td3, "REPLAY_ROWS", (50, 100))
    td3.main(parse("td3", ["--repeats", "1", "--out", str(tmp_path / "new" / "td3.csv")]))
    with (tmp_path / "new" / "td3.csv").open() as file:
        rows = list(csv.DictReader(file))
    rivals = ["TorchRL TD3Loss loop", "Stable-Baselines3 TD3", td3.BEST]
    assert [row["what"] for row in rows][:4] == [td3.OURS, *rivals]
    assert float(rows[0]["ratio_to_ours"]) == 1.0
    assert all(float(row["ms_per_update"]) > 0 for row in rows)
    printed = capsys.readouterr().out
    assert all(row["what"] in printed for row in rows)
