"""The watchdog barks once, in time, and only if nobody came."""

import threading
import time

from dynasindy.rig.flight import _Watchdog


def test_it_barks_when_nobody_comes():
    barked = threading.Event()
    watchdog = _Watchdog(barked.set)
    watchdog.within(0.05)
    assert barked.wait(10.0)
    assert watchdog.barked
    watchdog.close()


def test_it_is_quiet_before_the_first_deadline_and_after_a_renewal():
    calls = []
    watchdog = _Watchdog(lambda: calls.append(1))
    time.sleep(0.05)
    for _ in range(5):
        watchdog.within(30.0)
    watchdog.close()
    assert (calls, watchdog.barked) == ([], False)


def test_an_earlier_deadline_counts_at_once():
    barked = threading.Event()
    watchdog = _Watchdog(barked.set)
    watchdog.within(60.0)
    watchdog.within(0.01)
    assert barked.wait(10.0)
    watchdog.close()


def test_it_may_be_closed_by_what_it_calls():
    done = threading.Event()

    def bark():
        watchdog.close()
        done.set()

    watchdog = _Watchdog(bark)
    watchdog.within(0.0)
    assert done.wait(10.0)


def test_it_goes_on_watching_after_it_has_barked_and_after_an_error():
    barks = threading.Semaphore(0)

    def bark():
        barks.release()
        raise OSError("cut")

    watchdog = _Watchdog(bark)
    for _ in range(3):
        watchdog.within(0.01)
        assert barks.acquire(timeout=10.0)
    watchdog.close()
    assert not barks.acquire(timeout=0.05)
