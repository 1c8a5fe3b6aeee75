import html
import re
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from PIL import Image

from dynasindy.viz.report.vector import OFTEN, svg, write_figure
from dynasindy.viz.response import tracking

TIME = [0.0, 0.1, 0.2]


def figure(title: str = "a & b", name: str = "policy") -> Figure:
    return tracking(TIME, [[0.1, 0.2]] * 3, {name: [[0.0, 0.1], [0.1, 0.1], [0.1, 0.2]]}, title=title)


def test_the_vectors_of_a_figure_are_rounded_and_its_letters_are_text():
    element = svg(figure(), "f")
    assert element.startswith("<svg") and "<metadata>" not in element
    outlines = re.findall(r' (?:d|x|y)="([^"]+)"', element)
    assert outlines and not any(re.search(r"\.\d\d", outline) for outline in outlines)
    assert "a &amp; b</text>" in element and "DejaVu" not in element


def test_a_style_that_stands_often_is_written_once_and_looks_the_same():
    element = svg(figure(), "f")
    rules = dict(re.findall(r"\.(s[0-9a-f]+)\{([^}]+)\}", element))
    used = re.findall(r'class="(s[0-9a-f]+)"', element)
    assert rules and set(used) == set(rules) and len(used) > 4 * len(rules)
    assert not any(f'style="{style}"' in element for style in rules.values())
    assert any("stroke: #d9d9d9" in style for style in rules.values())  # the grid
    assert rules.items() <= dict(re.findall(r"\.(s[0-9a-f]+)\{([^}]+)\}", svg(figure("b"), "g"))).items()


def test_ids_begin_with_the_name_of_the_figure():
    element = svg(figure(), "f")
    ids, targets = re.findall(r'\bid="([^"]+)"', element), re.findall(r'(?:href="|url\()#([^")]+)', element)
    assert targets and set(targets) <= set(ids) and all(one.startswith("f-") for one in ids)


def test_text_in_a_figure_is_no_element_of_the_page():
    element = svg(figure("--><script>x</script>", "<script>"), "p")
    assert "<script" not in element and "-->" not in element and "<!--" not in element


def test_a_minus_sign_is_written_in_utf_8_whatever_the_machine_writes_in(tmp_path, monkeypatch):
    monkeypatch.setattr(
        Path, "write_text", lambda path, text, encoding="cp1252": path.write_bytes(text.encode(encoding))
    )
    text = write_figure(figure("\N{MINUS SIGN}1"), "f", tmp_path / "f.svg").read_bytes()
    assert "\N{MINUS SIGN}1</text>".encode() in text


@pytest.mark.parametrize(
    "label",
    [
        ' style="}*{display:none}"',
        ' d="M 1.2345 L 6.789"',
        ' x="1.2345"',
        ' id="a" href="#b" url(#c)',
        "'DejaVu Sans', sans-serif",
    ],
)
def test_a_label_that_reads_like_an_attribute_stays_a_label(label):
    several = Figure()
    for row in range(OFTEN + 2):
        several.text(0.1, 0.1 * row, f"k{label}")
    element = svg(several, "f")
    assert [html.unescape(words) for words in re.findall(r">(k[^<]*)</text>", element)] == [f"k{label}"] * (OFTEN + 2)
    assert "display" not in "".join(re.findall(r"<[^>]*>|\{[^}]*\}(?=[^<]*</style>)", element))


@pytest.mark.parametrize("suffix", ["svg", "png", "pdf"])
def test_a_figure_is_written_in_the_format_of_its_name(tmp_path, suffix):
    file = write_figure(figure(), "f", tmp_path / "new" / f"f.{suffix}")
    start = {"svg": b"<svg", "png": b"\x89PNG", "pdf": b"%PDF"}[suffix]
    assert file.read_bytes().startswith(start)
    if suffix == "png":
        with Image.open(file) as picture:
            assert picture.width == 700 and picture.mode == "P"
