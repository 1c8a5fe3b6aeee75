"""A check as plain numbers: its findings, and null for what is infinite or was not looked at."""

import json
import math

from dynasindy.checking import check_verdict
from dynasindy.checking.check import Settings, check
from dynasindy.checking.verdict import check_record, plain_number


def test_findings_come_first_and_what_is_infinite_is_null(loops, carts):
    """Of a cart on a spring with friction: what JSON holds is what the check found, in the same order."""
    found = check(loops(model=carts(spring=1.0, friction=0.5)), Settings((-0.4,), (0.4,), points=2, grid=3, draws=1))
    findings = check_verdict(found)
    held = json.loads(json.dumps(check_record(found, findings), allow_nan=False))
    assert next(iter(held)) == "verdict" and held["left"] == []
    assert [line["finding"] for line in held["verdict"]] == [each.name for each in findings]
    gains = [each.gain for target in found.margins for each in target]
    told = [target["margins"]["force"]["gain"] for target in held["targets"]]
    assert [value if value is not None else math.inf for value in told] == gains
    settling = found.spread.settling
    assert settling is not None
    assert [change["settling"] for change in held["changes"]] == settling[:, :-1].amax(0).tolist()
    assert plain_number(math.inf) is None and plain_number(math.nan) is None and plain_number(2.0) == 2.0
