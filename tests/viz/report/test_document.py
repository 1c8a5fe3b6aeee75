import re
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from PIL import Image

from dynasindy.viz.report.document import (
    Finding,
    Link,
    Listing,
    Picture,
    Section,
    Table,
    Text,
    Verdict,
    anchor,
    write_markdown,
)
from dynasindy.viz.report.page import write_html
from dynasindy.viz.response import tracking

TIME = [0.0, 0.1, 0.2]


def figure() -> Figure:
    return tracking(TIME, [[0.1, 0.2]] * 3, {"policy": [[0.0, 0.1], [0.1, 0.1], [0.1, 0.2]]}, title="a & b")


def page() -> list[Section]:
    parts = [
        Text("Words with `a < b` and **weight**."),
        Table(["name", "value"], [["a|b", "1"]]),
        Finding("xi", "it rises", "1 to 2", Verdict.AS),
        Finding("xi", "it falls", "1 to 2", Verdict.SHORT),
        Listing(["x' = 1", "y' = 2"]),
        Picture("first", figure(), "Two axes at 0.05 s.", "From a run."),
        Finding("xi", "who knows", "-"),
        Picture("second", figure(), "The same."),
    ]
    return [Section("Figure 1: All", parts), Section("Empty")]


def test_markdown_holds_every_part_and_its_figures_lie_beside_it(tmp_path):
    files = write_markdown("Title", page(), tmp_path / "new" / "page.md", ("svg", "png"))
    text = files[0].read_text()
    assert text.startswith("# Title\n\n## Figure 1: All\n")
    assert "| xi | it rises | 1 to 2 | as in the paper |\n| xi | it falls | 1 to 2 | not reached |" in text
    assert "| xi | who knows | - | not measured |" in text and "| a\\|b | 1 |" in text
    assert "    x' = 1\n    y' = 2\n" in text
    assert "![Two axes at 0.05 s](figures/first.svg)\n\nTwo axes at 0.05 s. From a run." in text
    assert {f.relative_to(tmp_path / "new").as_posix() for f in files[1:]} == {
        f"figures/{name}.{suffix}" for name in ("first", "second") for suffix in ("svg", "png")
    }
    with Image.open(tmp_path / "new" / "figures" / "first.png") as picture:
        assert picture.width == 700


@pytest.mark.parametrize("title", ["Figure 5: chirp input", "Table 2: SINDy model Xi matrix"])
def test_anchors_are_plain_words(title):
    assert re.fullmatch(r"[a-z0-9-]+", Section(title).anchor)


def test_a_link_in_a_table_leads_to_its_section_and_carries_no_link_of_others(tmp_path):
    table = Table(
        ["a"], [[Link("go (1|2)", "Figure 5: chirp, input")], ["[x](http://y)"], [Link("[x](http://y)", "B")]]
    )
    text = write_markdown("t", [Section("s", [table])], tmp_path / "page.md", ["svg"])[0].read_text()
    assert "| [go (1\\|2)](#figure-5-chirp-input) |" in text
    assert text.count("](http") == 0 and anchor("Figure 11: Dyna-Style vs. Direct") == "figure-11-dyna-style-vs-direct"


def test_paragraphs_of_the_markdown_page_are_wrapped_and_lose_no_word(tmp_path):
    words = "a paragraph with a `python scripts/train.py system=xi` in it, and a-hyphen-that-stays " * 9
    write_markdown("t", [Section("s", [Text(words)])], tmp_path / "page.md", ["svg"])
    lines = (tmp_path / "page.md").read_text().splitlines()[4:]
    assert " ".join(lines) == words.strip() and 100 < max(map(len, lines)) <= 120


def test_a_page_is_written_in_utf_8_whatever_the_machine_writes_in(tmp_path, monkeypatch):
    monkeypatch.setattr(
        Path, "write_text", lambda path, text, encoding="cp1252": path.write_bytes(text.encode(encoding))
    )
    files = write_markdown("t", [Section("s", [Text("from \N{MINUS SIGN}1")])], tmp_path / "page.md", ["svg"])
    assert "from \N{MINUS SIGN}1".encode() in files[0].read_bytes()


HOSTILE = (
    "<script>alert(1)</script> <img src=x onerror=y> "
    "[a](javascript:b) ![c](http://d) `e` **f** | g \n\n# h\n\n</td></table>"
)
PARTS = [Text(HOSTILE), Table([HOSTILE], [[HOSTILE]]), Finding(HOSTILE, HOSTILE, HOSTILE), Listing([HOSTILE])]


@pytest.mark.parametrize("part", PARTS, ids=lambda part: type(part).__name__)
def test_words_of_others_are_shown_and_are_neither_html_nor_links(part, tmp_path):
    hostile = [Section("Results", [part, Picture("p", figure(), HOSTILE)])]
    page = write_html("Title", hostile, tmp_path / "page.html").read_text().partition("</head>")[2]
    assert not re.search(
        r"<script(?! type=.application/json)|<img|onerror=(?!y&gt;)|href=\"javascript|</td></table>(?!</tbody>)", page
    )
    text = write_markdown("Title", hostile, tmp_path / "page.md", ("svg",))[0].read_text()
    shown = [line for line in text.splitlines() if not line.startswith("    ")]  # a code block shows what it holds
    assert not [line for line in shown if re.search(r"<script|<img|</t|\]\((?!figures/p\.svg\))|^# h", line)]
    assert text.count("figures/p.svg") == 1


@pytest.mark.parametrize("name", ["../x", "a/b", 'a" onload="x', "", "<b>"])
def test_a_figure_is_named_by_one_plain_name(name):
    with pytest.raises(ValueError, match="is no file name"):
        Picture(name, figure(), "")
