"""The numbers of an observer in C are those of the observer; what is impossible is refused before C is written."""

from dataclasses import replace

import pytest

from dynasindy.export import controller_sources
from dynasindy.export.filter import Filter, stop_words
from dynasindy.sindy import Oracle
from dynasindy.systems import Stops


def numbers(words):
    return [float(word.strip("()")) for word in words.split(", ")]


def test_variances_are_those_of_sensors_and_noise(pendulum):
    found = Filter.of(pendulum().observer)
    # A state is 1.5 rad wide, its encoder has steps of 0.01 rad and noise of 0.002 rad.
    assert found.sensed == (0,)
    assert numbers(found.words["variance"]) == pytest.approx([0.01**2 / 12 + 0.002**2])
    assert numbers(found.words["strays"]) == pytest.approx(
        [(0.013 * 1.5) ** 2 * 0.04, (0.021 * 3) ** 2 * 0.04, (0.4 * 3) ** 2 * 0.04]
    )
    assert numbers(found.words["unknown"]) == pytest.approx([0.15**2, 0.3**2, 0.3**2])
    assert found.words["pushed"] == "1" and "of the pushes" in found.words["pushes_word"]
    assert Filter.of(pendulum(disturbance=False).observer).words["pushes_word"] == ""


@pytest.mark.parametrize(
    ("delay", "late", "part", "steps"),
    [(0.0, 1, 0.0, (3, 3)), (0.04, 2, 0.0, (3, 6)), (0.07, 2, 0.03, (1 + 2, 2 + 6)), (0.01, 1, 0.01, (2 + 1, 1 + 3))],
)
def test_a_delay_is_whole_periods_and_a_rest(pendulum, delay, late, part, steps):
    found = Filter.of(pendulum(delay=delay).observer)
    n, m, memory, period, ahead = found.sizes
    assert (n, m, memory - 2) == (3, 1, late)
    assert numbers(found.words["part"]) == pytest.approx([part], abs=1e-12)
    assert numbers(found.words["rest"]) == pytest.approx([0.04 - part])
    assert (period, ahead) == steps and ("part" in found.flags) == bool(part)


def test_a_model_of_another_kind_is_refused(pendulum):
    observer = pendulum().observer
    observer.model = Oracle(observer.model.signature, system=observer.model)
    with pytest.raises(ValueError, match="works on a Oracle, which is not written in C"):
        Filter.of(observer)


def test_a_stop_may_be_at_one_side_alone():
    words, count = stop_words(Stops((1,), (0,), (-0.5,), (float("inf"),)), 2)
    assert count == 1 and words["stop_low"] == "(-0.5)" and words["stop_high"] == "INFINITY"
    assert stop_words(None, 2) == ({}, 0)


@pytest.mark.parametrize("positions", [(7,), (-1,), ("0",)])
def test_stops_at_states_that_do_not_exist_are_refused(pendulum, positions):
    controller = pendulum()
    controller.observer.stops = replace(controller.observer.stops, positions=positions)
    with pytest.raises(ValueError, match="allowed are whole numbers from 0 to 1"):
        controller_sources(controller)
