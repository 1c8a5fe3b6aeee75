"""The report of the results in the repository: every figure and table of the paper, whatever is saved."""

import csv
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from dynasindy.viz.report.build import build, pages, sections
from dynasindy.viz.report.document import Picture, Table
from dynasindy.viz.report.sources import Results

RESULTS = Path(__file__).parents[3] / "docs" / "results"
PAPER = [
    "Figures 1 to 4",
    "Figure 5: chirp input",
    "Figures 6 and 7: training data",
    "Table 1: agent training hyperparameters",
    "Figure 8: SINDy model learning progress",
    "Figure 9: predicted and real states before",
    "Figure 10: predicted and real states after",
    "Table 2: SINDy model Xi matrix",
    "Figure 11: Dyna-Style vs. Direct TD3 average rewards",
    "Figures 12 and 13: azimuth and pitch step",
    "Figure 14: sine wave",
    "Figure 15: square wave",
]


FIRST = ["The verdict", "Every statement of the paper", "How a verdict is given"]


@pytest.fixture(scope="module")
def saved() -> Results:
    files = RESULTS.glob("runs/*/config.yaml")
    return Results(RESULTS, {file.parent.name: OmegaConf.to_container(OmegaConf.load(file)) for file in files})


@pytest.fixture(scope="module")
def report(saved, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    files = build(saved, folder, formats=("svg",))
    assert files[:2] == [folder / "report.html", folder / "report.md"]
    return folder


def titles(text: str) -> list[str]:
    return re.findall(r"^## (.+)$", text, re.M)


def test_every_figure_and_table_of_the_paper_has_its_section_in_both_pages(report):
    markdown, page = (report / "report.md").read_text(), (report / "report.html").read_text()
    found = [title for title in titles(markdown)[3:] if not title.startswith("Beyond")]
    assert titles(markdown)[:3] == FIRST
    assert len(found) == len(PAPER) and all(title.startswith(name) for title, name in zip(found, PAPER, strict=True))
    assert re.findall(r"<h2>(.+?)</h2>", page) == titles(markdown)


class References(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found, self.tags, self.keys = [], set(), set()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.keys |= {key for key, _ in attrs}
        self.found += [value for key, value in attrs if key in ("href", "src", "xlink:href", "srcset", "data")]


def test_the_html_needs_no_other_file(report):
    page = (report / "report.html").read_text()
    references = References()
    references.feed(page)
    assert all(target.startswith("#") for target in references.found)
    assert not references.tags & {"link", "img", "iframe"} and "@import" not in page
    assert "src" not in references.keys and "http" not in re.sub(r"xmlns(:xlink)?=.http[^ ]+|http-equiv", "", page)
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]+)\)", page))
    assert "/root/" not in page and "/tmp/" not in page and "/home/" not in page


def test_the_figures_of_the_markdown_lie_beside_it(report):
    linked = re.findall(r"\]\((figures/[^)]+)\)", (report / "report.md").read_text())
    assert linked and all((report / target).is_file() for target in linked)
    assert len(linked) == (report / "report.html").read_text().count("<svg xmlns")


def test_the_markdown_leads_to_the_same_page_as_html(report):
    first = (report / "report.md").read_text().split("\n\n")[1]
    (target,) = re.findall(r"\]\(([^)]+)\)", first)
    assert target == "report.html" and (report / target).is_file()


def test_the_identification_table_is_the_csv_cell_by_cell(saved):
    section = next(s for s in sections(saved) if s.title.endswith("identification"))
    (table,) = [part for part in section.parts if isinstance(part, Table)]
    with (RESULTS / "identification.csv").open(newline="") as file:
        header, *rows = list(csv.reader(file))
    assert list(table.header) == header and [list(row) for row in table.rows] == rows


def test_without_any_result_every_section_stands_and_says_what_makes_it(empty, tmp_path):
    html, markdown, *figures = build(empty, tmp_path / "report")
    assert {figure.stem for figure in figures} == {"framework"}
    text = markdown.read_text()
    assert len(titles(text)) == len(FIRST) + len(PAPER) + 7 and html.is_file()
    blocks = dict(zip(titles(text), re.split(r"^## .+$", text, flags=re.M)[1:], strict=True))
    for title, block in blocks.items():
        if not title.startswith((*FIRST, "Figures 1 to 4")):
            assert re.search(r"Not measured: .* `python scripts/\w+\.py[^`]*`.* makes (it|them)\.", block), title


def test_without_any_result_every_statement_counts_as_not_measured(saved, empty):
    """By the plants and experiments that the paper's figures are compared in, the same ones as with all results."""
    everything, nothing = (
        {(finding.case, finding.paper, finding.claim) for section in sections(one) for finding in section.findings}
        for one in (saved, empty)
    )
    assert everything == nothing and len(nothing) > 100
    words = pages(empty)[1].parts[0].words
    assert words.startswith(f"Of {len(nothing)} comparisons: 0 as in the paper,")
    assert f"0 not reached, {len(nothing)} not measured." in words


@pytest.mark.parametrize("formats", [[], ["pdf", "svg"]])
def test_formats_that_no_page_shows_are_refused(empty, tmp_path, formats):
    with pytest.raises(ValueError, match="a page shows svg or png, name one of them first"):
        build(empty, tmp_path / "report", formats)
    assert not (tmp_path / "report").exists()


def test_a_picture_names_the_command_and_the_commit_of_its_runs_and_no_column(saved):
    pictures = [part for section in sections(saved) for part in section.parts if isinstance(part, Picture)]
    assert len(pictures) > 40
    for picture in pictures:
        if picture.name != "framework":
            assert re.search(
                r"(made by|with the settings of) `python scripts/\w+\.py [^`]+` at commit [0-9a-f]{7}", picture.source
            ), picture.name
            assert "column" not in picture.source
        assert picture.caption.endswith(".") and "Run `" not in picture.caption


def test_the_page_is_no_larger_than_two_and_a_half_megabytes(report):
    assert (report / "report.html").stat().st_size < 2.5e6


def test_lengths_of_the_runs_are_told_beside_the_claims(saved):
    words = " ".join(part.words for part in pages(saved)[0].parts if hasattr(part, "words"))
    for plant, experiment in (("xi", "dyna"), ("tras", "paper")):
        rows = (RESULTS / "runs" / f"{plant}_{experiment}_rollouts_800" / "progress.csv").read_text().splitlines()
        assert f"on `{plant}` ({len(rows) - 1} episodes)" in words
