"""Findings are lines, and what may mend several of them is said once."""

from dynasindy.checking.verdict import CheckFinding, in_lines


def test_a_finding_is_a_line():
    assert str(CheckFinding("a", True, "b")) == "ok    a: b" and str(CheckFinding("a", False, "b")) == "WEAK  a: b"


def test_what_may_mend_several_findings_stands_behind_the_first_weak_one():
    weak = [
        CheckFinding(name, name == "gain margin", "b")
        for name in ("gain margin", "phase margin", "disk margin", "slew")
    ]
    lines = in_lines([*weak, CheckFinding("a", False, "b")])
    # Of the margins only the first weak one has the advice, which all of them share; that on the slew is another one.
    assert lines[0] == "ok    gain margin: b" and lines[2] == "WEAK  disk margin: b" and lines[4] == "WEAK  a: b"
    assert lines[1] == str(weak[1]) and "planning.margin=" in lines[1] and "planning.margin=" not in lines[3]
    assert lines[3] == str(weak[3]) and "rate_weight" in lines[3]
