"""Names, words and numbers of files stay names, words and numbers, also in templates that they are filled into."""

import math
import re

import jinja2
import pytest

from dynasindy.control.c_code import fill, model_sources
from dynasindy.sindy import SindyModel
from dynasindy.sindy.formulas import comment, number
from dynasindy.systems import Pendulum, Signature


def test_identifiers_are_of_ascii_letters_and_differ():
    names = ("a b", "a_b", "a.b", "a_b_2", "Ωmega", "int")
    model = SindyModel(Signature(names, ("-",) * 6, ("u",), (1.0,) * 6), ["u"])
    found = re.findall(r"^ *model_x_(.*) = \d", model_sources(model).header, re.M)
    assert found[0] == "a_b" and found[-1] == "int"
    assert len(set(found)) == 6
    assert all(re.fullmatch(r"[A-Za-z0-9_]+", word) for word in found)


@pytest.mark.parametrize(
    "words", ["*/ int f() /*", "/*/", "*/*/*", "*°/", "a\\", "a\nb", "a??/", "·/", "/·", "\x00", "³·/²"]
)
def test_no_words_end_a_comment_or_begin_one(words):
    shown = comment(words)
    assert "*/" not in shown and "/*" not in shown and not set("\\\n?\x00") & set(shown)
    assert shown.isascii() and comment(shown) == shown


def test_a_number_is_exact_and_finite():
    for value in (0.1, -1e-300, 3, 1 / 3, 5e22):
        assert float(number(value).strip("()")) == value
    assert number(-2.5) == "(-2.5)"
    with pytest.raises(ValueError, match=r"inf .*finite"):
        number(math.inf)
    with pytest.raises(ValueError, match="nan stands"):
        number(math.nan)
    with pytest.raises(ValueError, match="could not convert"):
        number("system()")


@pytest.mark.parametrize("name", ["", "1a", "a-b", "a b", "a" * 32, "é", "a\n"])
def test_what_begins_no_name_of_c_is_refused(name):
    with pytest.raises(ValueError, match="letter"):
        model_sources(SindyModel(Pendulum().signature, ["u"]), name)


def test_what_is_filled_in_is_not_looked_at_again():
    with pytest.raises(jinja2.UndefinedError):
        fill("model.h", name="m")
    text = fill("model.h", name="m", kind="{{ 1 + 1 }}", about=["@ if x"], places=["m_x_a = 0"], head="void f(void)")
    assert "{{ 1 + 1 }}" in text and " * @ if x\n" in text
