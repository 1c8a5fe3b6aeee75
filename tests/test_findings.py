"""Findings are data: they survive JSON and pickling, have a sentence each, and name settings as their reader does."""

import json
import math
import pickle
import re
from pathlib import Path

import pytest
import yaml

import dynasindy
from dynasindy.findings import Finding, LogError, note, records, weak, wrong
from dynasindy.sentences import SENTENCES, lines, sentence, setting

PACKAGE = Path(dynasindy.__file__).parent
CODE = re.compile(r'"((?:log|fit|model|forecast|control|check|run|plant|excitation)\.[a-z_]+)"')


def test_every_code_has_a_sentence_and_every_sentence_a_code():
    files = [*PACKAGE.rglob("*.py"), *(Path(__file__).parents[1] / "scripts").rglob("*.py")]
    text = "".join(file.read_text() for file in files if file.name != "sentences.py")
    made = re.findall(r'(?:note|weak|wrong|Error)\)?\(\s*"([a-z_]+\.[a-z_]+)"', text)
    assert {*made} <= {*SENTENCES} and len(made) > 60
    assert [c for c in SENTENCES if c not in CODE.findall(text) and f'"{c.partition(".")[2]}"' not in text] == []


def test_a_finding_is_plain_data():
    found = wrong("model.misses", seconds=0.5, errors={"q": math.inf}, units={"q": "m"}, held={"q": 0.1})
    record = json.loads(json.dumps(found.record(), allow_nan=False))
    assert (record["code"], record["severity"]) == ("model.misses", "wrong")
    assert Finding.from_record(record) == found and str(Finding.from_record(record)) == str(found)
    assert "runs away m; the last value held misses 0.1" in str(found)
    small = note("log.gaps", count=3)
    assert Finding.from_record(small.record()) == small and records([small]) == [small.record()]


def test_an_error_is_a_finding_and_can_be_pickled():
    error = pickle.loads(pickle.dumps(LogError("log.constant_input", file="log.csv", input="u", value=2.0)))
    assert isinstance(error, ValueError) and error.finding.values["value"] == 2.0
    assert str(error).startswith("log.csv: ") and error.finding.severity == "wrong"


def test_the_gravest_comes_first():
    found = lines([note("log.no_time"), wrong("fit.dropped"), weak("log.whole_seconds", column="t")])
    assert [line.partition(":")[0] for line in found] == ["wrong", "warning", "note"]


@pytest.mark.parametrize(
    "value", [{"q": {"name": "q", "unit": "m/s", "scale": 0.5}}, {"q": "q [m], raw"}, ["a", "b"], 0.25]
)
def test_a_setting_is_what_the_reader_can_give(monkeypatch, value):
    """On the command line it is YAML, and in Python an argument."""
    word = setting("data.states", value)
    assert eval(word.removeprefix("read(states=").removeprefix("states=").removesuffix(")")) == value
    monkeypatch.setattr("dynasindy.sentences._words_of_commands", True)
    key, _, text = setting("data.states", value).strip("'").partition("=")
    assert key == "data.states" and yaml.safe_load(text) == value


@pytest.mark.parametrize("code", ["run.gate_closed", "check.slew", "check.stability", "run.tracked", "control.period"])
def test_a_finding_of_another_version_says_what_it_holds(code):
    assert sentence(code, {"unlike": 2}) == f"{code}: unlike 2"
