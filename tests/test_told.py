from dynasindy.told import Told, counted, hearing, tell, telling


def test_what_is_told_is_heard_inside_and_nobody_misses_it_outside():
    heard = []
    tell("before")
    with hearing(heard.append):
        tell("fit", 2, 5, "steps", "slowly")
    tell("after")
    assert heard == [Told("fit", 2, 5, "steps", "slowly")]


def test_items_are_counted_as_they_are_done():
    heard = []
    with hearing(heard.append):
        assert list(counted("walk", "abc", 3, "miles")) == ["a", "b", "c"]
    assert [told.done for told in heard] == [0, 1, 2, 3]
    assert heard[1].counted() == "1 of 3 miles"


def test_nothing_is_said_where_nothing_is_counted():
    assert Told("fit").counted() == ""
    assert Told("fit", 3, unit="steps").counted() == "3 steps"


def test_what_the_parts_of_a_phase_tell_is_told_of_it_until_it_ends_or_fails():
    heard = []
    with hearing(heard.append):
        try:
            with telling("actuators"):
                tell("fit", words="6 coefficients")
                raise ValueError
        except ValueError:
            tell("fit")
    assert heard == [Told("actuators"), Told("actuators", words="6 coefficients"), Told("fit")]


def test_a_sweep_that_is_told_of_during_a_phase_is_not_taken_for_the_phase():
    heard = []
    with hearing(heard.append), telling("fit to log.csv"):
        tell("sweep", 1, 2, "jobs", around=True)
    assert heard == [Told("fit to log.csv"), Told("sweep", 1, 2, "jobs", around=True)]
