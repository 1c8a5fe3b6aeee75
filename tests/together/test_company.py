"""Runs go in lockstep: what they need at the same time is done at once, and each is told of its own errors."""

import threading
from dataclasses import dataclass

import pytest
import torch

from dynasindy.together import Carried, Company, here
from dynasindy.together.company import Work, found


@dataclass(eq=False)
class Sum(Work):
    """Add one to a number; a company is told how many were added at once."""

    number: int
    name: str = "sum"
    first: bool = False

    @property
    def kind(self):
        return self.name

    @property
    def waits(self):
        return self.first

    def done(self, all_of_it, company):
        company.kept.setdefault("log", []).append((self.name, [work.number for work in all_of_it]))
        return [ValueError(f"{work.number} is odd") if work.number % 2 else work.number + 1 for work in all_of_it]


def test_work_of_one_kind_is_done_at_once_in_the_order_of_the_runs():
    company = Company()
    assert company.run([lambda n=n: here().ask(Sum(n)) * 10 for n in (0, 2, 4)]) == [10, 30, 50]
    assert company.kept["log"] == [("sum", [0, 2, 4])]


def test_work_of_several_kinds_is_done_apart():
    company = Company()
    company.run([lambda n=n: here().ask(Sum(n, name="ab"[n // 2 % 2])) for n in (0, 2, 4)])
    assert company.kept["log"] == [("a", [0, 4]), ("b", [2])]


def test_a_run_that_skips_a_phase_falls_into_step_again():
    def _run(plans):
        for lap in range(2):
            here().ask(Sum(lap * 10, name="lap", first=True))
            if plans:
                here().ask(Sum(lap * 10 + 2, name="plan"))

    company = Company()
    company.run([lambda plans=plans: _run(plans) for plans in (True, False, True)])
    laps = [("lap", [0, 0, 0]), ("plan", [2, 2]), ("lap", [10, 10, 10]), ("plan", [12, 12])]
    assert company.kept["log"] == laps


def test_a_run_that_fails_does_not_end_the_others_and_is_told_its_own_error():
    def _run(n):
        try:
            return here().ask(Sum(n))
        except ValueError as error:
            raise RuntimeError(f"{error}, says the run") from error

    one, two, three = Company().run([lambda n=n: _run(n) for n in (0, 3, 4)])
    assert (one, three) == (1, 5)
    assert isinstance(two, RuntimeError)
    assert str(two) == "3 is odd, says the run"


def test_an_error_of_the_work_itself_reaches_all_runs():
    class Broken(Sum):
        def done(self, all_of_it, company):
            raise ZeroDivisionError("broken")

    assert [str(error) for error in Company().run([lambda: here().ask(Broken(0))] * 2)] == ["broken"] * 2


def test_each_run_finds_what_is_one_for_all_as_it_left_it():
    now = {"job": None}

    def _run(n):
        now["job"] = n
        here().ask(Sum(0))
        return now["job"]

    carried = Carried(lambda: now["job"], lambda kept: now.update(job=kept))
    assert Company(carried=carried).run([lambda n=n: _run(n) for n in range(3)]) == [0, 1, 2]


def test_one_run_moves_at_a_time():
    moving, most = [], []

    def _run():
        for _ in range(5):
            moving.append(1)
            most.append(len(moving))
            moving.pop()
            here().ask(Sum(0))

    Company().run([_run] * 4)
    assert max(most) == 1


def test_a_run_alone_is_a_company_and_there_is_none_outside():
    assert here() is None
    with Company().alone():
        assert here().ask(Sum(2)) == 3
    assert here() is None


def test_each_run_is_stopped_in_its_own_time_when_the_process_is():
    stopped = []

    class Interrupted(Sum):
        def done(self, all_of_it, company):
            signal = KeyboardInterrupt()
            signal.signal = 15
            raise signal

    def _run(n):
        try:
            here().ask(Interrupted(n))
        except KeyboardInterrupt as signal:
            stopped.append((n, signal.signal))
            raise
        finally:
            with pytest.raises(KeyboardInterrupt):  # nothing more is done
                here().ask(Sum(0))

    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        Company().run([lambda n=n: _run(n) for n in range(3)])
    assert stopped == [(0, 15), (1, 15), (2, 15)]
    assert threading.active_count() == before


@pytest.mark.parametrize("device", ["tpu", "cude", "meta", "cuda:99"])
def test_a_device_that_is_none_is_refused_with_those_there_are(device):
    with pytest.raises(ValueError, match=f"device={device} is not to be had; on this machine there is cpu"):
        found(device)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_cuda_is_refused():
    with pytest.raises(ValueError, match="torch finds no GPU"):
        Company("cuda")


def test_the_room_that_was_not_used_longest_goes_first(monkeypatch):
    monkeypatch.setattr("dynasindy.together.company.ROOMS", 2)
    company = Company()
    first, second = company.room("a", object), company.room("b", object)
    assert company.room("a", object) is first
    third = company.room("c", object)
    assert company.kept == {"a": first, "c": third}
    assert company.room("b", object) is not second
