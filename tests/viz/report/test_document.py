import re
from html.parser import HTMLParser

import pytest
from matplotlib.figure import Figure
from PIL import Image

from dynasindy.viz.report.document import (
    Finding,
    Listing,
    Picture,
    Section,
    Table,
    Text,
    svg,
    write_html,
    write_markdown,
)
from dynasindy.viz.response import tracking

TIME = [0.0, 0.1, 0.2]


def figure() -> Figure:
    return tracking(TIME, [[0.1, 0.2]] * 3, {"policy": [[0.0, 0.1], [0.1, 0.1], [0.1, 0.2]]}, title="a & b")


def page() -> list[Section]:
    parts = [
        Text("Words with `a < b` and **weight**."),
        Table(["name", "value"], [["a|b", "1"]]),
        Finding("it rises", "1 to 2", True),
        Finding("it falls", "1 to 2", False),
        Listing(["x' = 1", "y' = 2"]),
        Picture("first", figure(), "Two axes at 0.05 s. From a run."),
        Finding("who knows", "-"),
        Picture("second", figure(), "The same."),
    ]
    return [Section("Figure 1: All", parts), Section("Empty")]


def test_markdown_holds_every_part_and_its_figures_lie_beside_it(tmp_path):
    files = write_markdown("Title", page(), tmp_path / "new" / "page.md", ("svg", "png"))
    text = files[0].read_text()
    assert text.startswith("# Title\n\n## Figure 1: All\n")
    assert "| it rises | 1 to 2 | yes |\n| it falls | 1 to 2 | no |" in text
    assert "| who knows | - | not measured |" in text and "| a\\|b | 1 |" in text
    assert "    x' = 1\n    y' = 2\n" in text
    assert "![Two axes at 0.05 s](figures/first.svg)\n\nTwo axes at 0.05 s. From a run." in text
    assert {f.relative_to(tmp_path / "new").as_posix() for f in files[1:]} == {
        f"figures/{name}.{suffix}" for name in ("first", "second") for suffix in ("svg", "png")
    }
    with Image.open(tmp_path / "new" / "figures" / "first.png") as picture:
        assert picture.width == 700


class Reader(HTMLParser):
    """Collects what the tags of a page refer to, and its ids."""

    def __init__(self) -> None:
        super().__init__()
        self.targets, self.ids = [], []

    def handle_starttag(self, tag, attrs):
        self.targets += [v for k, v in attrs if k in ("href", "src", "xlink:href", "action", "data", "srcset")]
        self.ids += [v for k, v in attrs if k == "id"]


def test_html_refers_to_nothing_outside_itself_and_its_ids_are_unique(tmp_path):
    text = write_html("A < B", page(), tmp_path / "page.html").read_text()
    reader = Reader()
    reader.feed(text)
    assert reader.targets and all(target.startswith("#") for target in reader.targets)
    assert {target[1:] for target in reader.targets} <= set(reader.ids)
    assert len(reader.ids) == len(set(reader.ids))
    assert "<code>a &lt; b</code>" in text and "<strong>weight</strong>" in text and "<title>A &lt; B</title>" in text
    assert '<td class="yes">yes</td>' in text and '<td class="no">no</td>' in text
    assert text.count("<svg") == 2 and "<script" not in text and "@import" not in text


def test_the_vectors_of_a_figure_are_rounded_outlines_not_scales():
    element = svg(figure(), "f")
    assert element.startswith("<svg") and "<metadata>" not in element
    outlines = re.findall(r' d="([^"]+)"', element)
    assert outlines and not any(re.search(r"\.\d\d", outline) for outline in outlines)
    assert "scale(0.015625)" in element


def test_letters_that_a_page_has_are_not_drawn_again():
    drawn: set[str] = set()
    first, second = (svg(figure(), name, drawn) for name in ("a", "b"))
    assert '<path id="DejaVu' in first and '<path id="DejaVu' not in second and "#DejaVu" in second


@pytest.mark.parametrize("title", ["Figure 5: chirp input", "Table 2: SINDy model Xi matrix"])
def test_anchors_are_plain_words(title):
    assert re.fullmatch(r"[a-z0-9-]+", Section(title).anchor)


def test_paragraphs_of_the_markdown_page_are_wrapped_and_lose_no_word(tmp_path):
    words = "a paragraph with a `python scripts/train.py system=xi` in it, and a-hyphen-that-stays " * 9
    write_markdown("t", [Section("s", [Text(words)])], tmp_path / "page.md", ["svg"])
    lines = (tmp_path / "page.md").read_text().splitlines()[4:]
    assert " ".join(lines) == words.strip() and 100 < max(map(len, lines)) <= 120


HOSTILE = (
    "<script>alert(1)</script> <img src=x onerror=y> "
    "[a](javascript:b) ![c](http://d) `e` **f** | g \n\n# h\n\n</td></table>"
)
PARTS = [Text(HOSTILE), Table([HOSTILE], [[HOSTILE]]), Finding(HOSTILE, HOSTILE), Listing([HOSTILE])]


@pytest.mark.parametrize("part", PARTS, ids=lambda part: type(part).__name__)
def test_words_of_others_are_shown_and_are_neither_html_nor_links(part, tmp_path):
    hostile = [Section("Results", [part, Picture("p", figure(), HOSTILE)])]
    page = write_html("Title", hostile, tmp_path / "page.html").read_text()
    assert not re.search(r"<script|<img|onerror=(?!y&gt;)|href=\"javascript|</td></table>(?!</tbody>)", page)
    text = write_markdown("Title", hostile, tmp_path / "page.md", ("svg",))[0].read_text()
    shown = [line for line in text.splitlines() if not line.startswith("    ")]  # a code block shows what it holds
    assert not [line for line in shown if re.search(r"<script|<img|</t|\]\((?!figures/p\.svg\))|^# h", line)]
    assert text.count("figures/p.svg") == 1


def test_text_in_a_figure_is_no_element_of_the_page():
    drawn = tracking(TIME, [[0.1, 0.2]] * 3, {"<script>": [[0.0, 0.1]] * 3}, title="--><script>x</script>")
    element = svg(drawn, "p")
    assert "<script" not in element and "--" not in element


@pytest.mark.parametrize("name", ["../x", "a/b", 'a" onload="x', "", "<b>"])
def test_a_figure_is_named_by_one_plain_name(name):
    with pytest.raises(ValueError, match="is no file name"):
        Picture(name, figure(), "")
