from dynasindy.told import Told, counted, hearing, tell


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
