import pickle

from dynasindy.systems import Diverged


def test_it_is_no_wrong_setting_and_reaches_the_process_that_started_a_worker():
    diverged = pickle.loads(pickle.dumps(Diverged("the reward is nan")))
    assert isinstance(diverged, ArithmeticError) and not isinstance(diverged, ValueError)
    assert str(diverged) == "the reward is nan"
