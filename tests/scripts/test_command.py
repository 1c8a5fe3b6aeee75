"""What a command warns of: in words where the package speaks, with its place where a library does."""

import sys
from pathlib import Path

import pytest

import dynasindy

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
sys.path.append(str(SCRIPTS))
from command import _in_one_line  # noqa: E402


def test_a_warning_of_the_package_is_words():
    file = Path(dynasindy.__file__).parent / "agents" / "machine.py"
    assert _in_one_line("TD3 is slow", UserWarning, str(file), 53) == "warning: TD3 is slow\n"


@pytest.mark.parametrize(
    "file",
    [
        "/home/u/dynasindy/.venv/lib/python3.12/site-packages/numpy/linalg.py",
        "/usr/lib/python3.12/ast.py",
        str(Path(dynasindy.__file__).parents[1] / "tests" / "dynasindy" / "mine.py"),
        "<string>",
    ],
)
def test_a_warning_of_a_library_has_its_place_and_category_wherever_the_checkout_is(file):
    told = _in_one_line("it is deprecated", DeprecationWarning, file, 7)
    assert told == f"{file}:7: DeprecationWarning: it is deprecated\n"
