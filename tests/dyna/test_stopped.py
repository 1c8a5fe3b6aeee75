import pickle
import signal

from dynasindy.dyna import Stopped


def test_what_a_worker_was_stopped_by_reaches_the_process_that_started_it():
    stopped = pickle.loads(pickle.dumps(Stopped("kept in runs/a", 15)))
    assert isinstance(stopped, KeyboardInterrupt) and not isinstance(stopped, Exception)
    assert (str(stopped), stopped.signal) == ("kept in runs/a", 15)


def test_a_run_is_stopped_by_ctrl_c_if_nothing_else_is_said():
    assert Stopped("kept").signal == signal.SIGINT
