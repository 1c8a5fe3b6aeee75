"""Words of a shell as Python, against what both read."""

import ast
import shlex

import pytest
import yaml

from dynasindy.evaluation.arguments import as_arguments
from dynasindy.sindy.functions import FunctionError, function


@pytest.mark.parametrize(
    ("word", "call"),
    [
        ("plant.known={angle: angle_rate, x: v}", "identify(known="),
        ('data.inputs={valve: {name: the valve, unit: "m°/s", scale: 1.0e-05, low: -12, high: 12.5}}', "read(inputs="),
        ("data.states={angle: {name: angle, unit: rad/s}, v_2: v_2}", "read(states="),
    ],
)
def test_a_map_is_a_dictionary_that_says_the_same(word, call):
    told = as_arguments(f"Give {shlex.quote(word)}: a column is read")
    assert told.startswith(f"Give {call}{{") and told.endswith("}): a column is read")
    dictionary = told.removeprefix(f"Give {call}").removesuffix("): a column is read")
    assert ast.literal_eval(dictionary) == yaml.safe_load(word.partition("=")[2])


def test_settings_lose_their_group_and_other_words_stay():
    told = as_arguments("data.inputs names 'torque' of data.csv; give plant.low, planning.updates or planning.csv")
    assert told == "inputs names 'torque' of data.csv; give low, updates or planning.csv"


def test_a_function_that_is_missed_is_registered_as_python_does():
    with pytest.raises(FunctionError, match="into") as error:
        function("flow")
    told = as_arguments(str(error.value))
    assert "plant.functions" not in told
    assert "register_function" in told
