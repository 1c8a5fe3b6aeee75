import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from dynasindy.viz.framework import framework
from dynasindy.viz.report import page as written
from dynasindy.viz.report.document import Finding, Link, Picture, Section, Table, Text, Verdict
from dynasindy.viz.report.page import write_html
from dynasindy.viz.response import tracking

TIME = [0.0, 0.1, 0.2]
HERE = Path(written.__file__).parent


def figure(name: str = "policy"):
    return tracking(TIME, [[0.1, 0.2]] * 3, {name: [[0.0, 0.1], [0.1, 0.1], [0.1, 0.2]]}, title="a & b")


def page() -> list[Section]:
    parts = [
        Text("Words with `a < b` and **weight**."),
        Finding("xi", "it rises", "1 to 2", Verdict.AS),
        Finding("xi", "it falls", "1 to 2", Verdict.SHORT),
        Table(["claim"], [[Link("in part (1 of 2)", "Figure 1: All")], [Link("holds (2 of 2)", "Empty")]]),
        Picture("first", figure(), "Two axes.", "Run `x`, made by `python y.py` at commit abc1234."),
        Picture("second", figure(), "The same."),
        Picture("drawing", framework(), "Boxes."),
    ]
    return [Section("Figure 1: All", parts), Section("Empty")]


@pytest.fixture(scope="module")
def text(tmp_path_factory) -> str:
    return write_html("A < B", page(), tmp_path_factory.mktemp("page") / "new" / "page.html").read_text()


class Reader(HTMLParser):
    """Collects what the tags of a page refer to, its ids, and the text of its scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.targets, self.ids, self.scripts, self.links, self.inside = [], [], [], {}, ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.targets += [v for k, v in attrs if k in ("href", "src", "xlink:href", "action", "data", "srcset")]
        self.ids += [v for k, v in attrs if k == "id"]
        self.inside = tag
        if tag == "script":
            self.scripts.append([dict(attrs).get("type"), ""])

    def handle_data(self, data):
        if self.inside == "script":
            self.scripts[-1][1] += data

    def handle_endtag(self, tag):
        self.inside = ""


def test_the_page_refers_to_nothing_outside_itself_and_its_ids_are_unique(text):
    reader = Reader(text)
    assert reader.targets and all(target.startswith("#") for target in reader.targets)
    assert {target[1:] for target in reader.targets} <= set(reader.ids)
    assert len(reader.ids) == len(set(reader.ids))
    assert "<code>a &lt; b</code>" in text and "<strong>weight</strong>" in text and "<title>A &lt; B</title>" in text
    assert "@import" not in text and not re.search(r"https?://(?!www\.w3\.org)", text)


def test_the_page_allows_itself_its_own_script_and_no_other(text):
    (kind, script), *data = Reader(text).scripts
    assert kind is None and {kind for kind, _ in data} == {"application/json"}
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]+)"', text)
    assert f"script-src 'sha256-{digest}'" in policy and "default-src 'none'" in policy
    assert script == "\n" + (HERE / "chart.js").read_text() + (HERE / "page.js").read_text()
    assert "eval(" not in script and "fetch(" not in script and "XMLHttp" not in script


def test_figures_show_without_a_script_and_bring_their_numbers_for_it(text):
    figures = re.findall(r"<figure.*?</figure>", text, re.S)
    assert [one.count("<svg ") for one in figures] == [1, 1, 1]
    numbers = [json.loads(found) for one in figures for found in re.findall(r'json">(.*?)</script>', one)]
    assert len(numbers) == 2  # the drawing has none
    assert numbers[0]["panels"][0]["lines"][1]["y"] == [0.0, 0.1, 0.1]
    assert "#000000" not in re.sub(r"<script.*?</script>", "", "".join(figures), flags=re.S)


def test_a_caption_is_followed_by_command_and_commit(text):
    assert (
        '<figcaption>Two axes.<p class="source">Run <code>x</code>, made by <code>python y.py</code> at commit '
        "abc1234.</p></figcaption>"
    ) in text


def test_verdicts_have_a_colour_each_and_claims_lead_to_their_evidence(text):
    text = re.sub(r' data-name="[^"]*"', "", text)
    assert '<td class="as">as in the paper</td>' in text and '<td class="short">not reached</td>' in text
    assert '<td class="part"><a href="#figure-1-all">in part (1 of 2)</a></td>' in text
    assert '<td class="as"><a href="#empty">holds (2 of 2)</a></td>' in text
    styles = (HERE / "page.css").read_text()
    assert all(f"td.{mark}" in styles for mark in {*written.MARKS.values()})


def test_cells_of_many_words_stay_readable_on_a_narrow_page(tmp_path):
    sentence = "Planning on the model lets the policy learn from fewer real episodes."
    part = Table(["claim", "number"], [[sentence, "as in the paper"], ["short", "0.1"]])
    page = write_html("t", [Section("s", [part])], tmp_path / "p.html").read_text()
    assert f'<td class="words">{sentence}</td><td class="as">' in page and "<td>short</td><td>0.1</td>" in page
    narrow = page.partition("@media (max-width: 60rem)")[2].partition("@media print")[0]
    assert "td.words { min-width: 13rem; }" in narrow


def test_a_verdict_beside_many_columns_is_in_sight_of_a_phone(tmp_path):
    """Rows of more than two columns become cards, in which each cell stands beside the name of its column."""
    wide = Table(["claim", "xi, `dyna`", "verdict"], [["it holds", "0.1", "as in the paper"]])
    parts = [wide, Table(["verdict", "means"], [["as in the paper", "x"]]), Table(["a", "b", "c"], [["1", "2", "3"]])]
    page = write_html("t", [Section("s", parts)], tmp_path / "p.html").read_text()
    assert page.count('<table class="cards">') == 1 and page.count("<table>") == 2
    assert '<td data-name="xi, dyna">0.1</td><td class="as" data-name="verdict">as in the paper</td>' in page
    phone = page.partition("@media screen and (max-width: 40rem)")[2].partition("@media print")[0]
    assert "content: attr(data-name)" in phone and ".cards thead { display: none; }" in phone


def test_the_contents_stay_on_a_wide_page_and_open_on_a_narrow_one_and_paper_is_white(text):
    styles = (HERE / "page.css").read_text()
    narrow, paper = styles.partition("@media (max-width: 60rem)")[2], styles.partition("@media print")[2]
    assert re.search(r"\nnav \{\s*position: fixed", styles)
    assert "#menu:checked ~ nav { display: block; }" in narrow and '<label for="menu">' in text
    assert "--page: #ffffff" in paper and "header, nav" in paper and "prefers-color-scheme: dark" in styles
    blocks = re.findall(r"\{([^{}]*--page: [^{}]*)\}", styles)
    colours = [set(re.findall(r"(--\w+): #", block)) for block in blocks]
    assert len(colours) == 4 and all(block == colours[0] for block in colours)
    used = set(re.findall(r"var\((--\w+)", styles)) - {"--pen", "--style"}
    assert used <= colours[0]


def test_words_in_the_numbers_of_a_figure_end_no_script(tmp_path):
    hostile = "</script><script>alert(1)</script>"
    part = Picture("p", figure(hostile), hostile)
    found = write_html("t", [Section("s", [part])], tmp_path / "p.html").read_text()
    scripts = Reader(found).scripts
    assert len(scripts) == 2 and json.loads(scripts[1][1])["panels"][0]["lines"][1]["name"] == hostile
