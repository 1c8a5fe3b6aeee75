"""Every function of the standards is answered once, by a line of its own or by one that does something."""

import re

import pytest

from dynasindy.export.fmi_names import ABSENT, FINE, answers
from dynasindy.export.templates import fill

COUNTS = {2: 44 - 10, 3: 75}
"""Functions in the headers of the standards; of FMI 2 those for model exchange alone are left out, as it allows."""


@pytest.mark.parametrize("version", [2, 3])
def test_each_is_there_once(version):
    words = {"version": version, "reference": "unsigned", "token": "t", "answers": answers(version)}
    text = fill("fmi.c", words) + fill(f"fmi{version}.c", words)
    written = re.findall(rf"^(?:EXPORT .*?\b|ANSWER\(|NOTHING\()(fmi{version}\w+)", text, re.M)
    assert len(written) == len(set(written)) == COUNTS[version]
    assert len({*FINE[version], *ABSENT[version]}) == len(FINE[version]) + len(ABSENT[version])
    assert f"fmi{version}DoStep" in written and "ANSWER(fmi" in text
