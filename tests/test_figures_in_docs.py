"""Every figure of README and docs is what its file says, or is named here with the reason why no file holds it.

The pages are tied to files by `tests/figures`: a page's words with the figures worked out from docs/results and conf.
A page that says something new needs a `Tie` there; a figure that no file holds needs an `Untied` with its reason.
"""

import json
import re

import ablation_page
import other_pages
import pytest
import results_page
from benchmarks import baselines
from tables import RESULTS, table
from ties import REPOSITORY, Tie, figures, flat, left_over, paragraphs, read

from dynasindy.evaluation.ablation import Level, read_rows, to_markdown
from dynasindy.evaluation.rows import read_rows as read_cells

TIED = {
    ablation_page.PAGE: ablation_page.ties,
    results_page.PAGE: results_page.ties,
    other_pages.README: other_pages.readme,
    other_pages.IDENTIFICATION: other_pages.identification,
    other_pages.BASELINES: other_pages.baselines,
    other_pages.SPEED: other_pages.speed,
}
UNTIED = [*ablation_page.UNTIED, *results_page.UNTIED, *other_pages.UNTIED]
SECTIONS = {results_page.PAGE: results_page.SECTIONS, "docs/algorithm.md": other_pages.COMPARED}
GENERATED = {"docs/results/ablation.md", "docs/report/report.md"}
"""Pages that code writes, compared whole."""
PAGES = ["README.md", *sorted(str(page.relative_to(REPOSITORY)) for page in (REPOSITORY / "docs").rglob("*.md"))]


def by_hand(page: str) -> str:
    """What people wrote in a page: not the tables that code writes, nor sections whose figures may stand untied."""
    text = read(page)
    if page == other_pages.BASELINES:
        text = text.partition(baselines.MARK)[0]
    for heading in SECTIONS.get(page, {}):
        assert f"## {heading}\n" in text, f"{page} has no section '{heading}' any more"
        text = re.sub(rf"^## {re.escape(heading)}\n.*?(?=^## |\Z)", "", text, flags=re.M | re.S)
    return text


def ties(page: str) -> list[Tie]:
    return list(TIED[page](read(page))) if page in TIED else []


@pytest.mark.parametrize("page", TIED)
def test_a_page_says_what_its_files_say(page):
    found = ties(page)
    assert len(found) > 3
    text = flat(read(page))
    missing = [tie.text for tie in found if tie.text not in text]
    assert not missing, f"{page} does not say, though its files do: " + "\n".join(missing)


@pytest.mark.parametrize("page", TIED)
def test_the_words_of_a_tie_hold_no_figure_of_their_own(page):
    assert not [tie.words for tie in ties(page) if figures(tie.words)]


@pytest.mark.parametrize("page", [page for page in PAGES if page not in GENERATED])
def test_every_other_figure_of_a_page_is_named_here_with_its_reason(page):
    known = [tie.text for tie in ties(page)] + [flat(other.words) for other in UNTIED if other.page == page]
    left = left_over(by_hand(page), known)
    assert not left, f"{page} has figures tied to no file: add a Tie, or an Untied with its reason: " + "\n".join(left)


@pytest.mark.parametrize("other", UNTIED, ids=lambda other: f"{other.page}: {other.words[:40]}")
def test_what_is_named_as_untied_still_stands_there(other):
    assert other.reason
    assert any(flat(other.words).removesuffix("...") in part for part in paragraphs(by_hand(other.page)))


def test_the_table_of_the_ablation_is_that_of_its_rows():
    assert (RESULTS / "ablation.md").read_text() == to_markdown(read_rows(RESULTS / "ablation.csv"), Level())


def test_the_tables_of_controllers_are_those_of_their_rows():
    shown = (RESULTS / "baselines.md").read_text().partition(f"{baselines.MARK}\n\n")[2]
    assert shown == "\n\n".join(baselines.tables(read_cells(RESULTS / "baselines.csv"))) + "\n"


ORIGINS = sorted(RESULTS.rglob("origin.json"))


@pytest.mark.parametrize("file", ORIGINS, ids=lambda file: file.parent.name)
def test_a_saved_run_names_its_command_and_a_commit_without_changes(file):
    origin = json.loads(file.read_text())
    assert origin["command"].startswith("python scripts/")
    assert re.fullmatch(r"[0-9a-f]{7,40}", origin["commit"]), f"{file.parent} was made at {origin['commit']}"


@pytest.mark.parametrize("name", ["ablation.csv", "gradient.csv"])
def test_every_row_names_a_commit_without_changes(name):
    dirty = {("_".join(row.get(key, "") for key in ("system", "experiment", "setting")), row["commit"])
             for row in table(name) if not re.fullmatch(r"[0-9a-f]{7,40}", row["commit"])}  # fmt: skip
    assert not dirty


def test_rows_of_the_ablation_are_those_of_the_saved_runs():
    compared, longer = 0, set()
    for row in table("ablation.csv"):
        folder = RESULTS / "runs" / "_".join(row[key] for key in ("system", "experiment", "setting"))
        if row["seed"] == "0" and folder.is_dir():
            metrics = json.loads((folder / "metrics.json").read_text())
            if float(row["real_steps"]) > metrics["cost"]["real_steps"]:
                longer.add(folder.name)  # ended by the loan of its GPU before it could write its policy
                continue
            ends = metrics["evaluation"]
            assert row["commit"] == json.loads((folder / "origin.json").read_text())["commit"]
            assert float(row["final_return"]) == pytest.approx(ends["return"], rel=1e-6)
            errors = [ends[f"steady_state_error/{axis}"] for axis in ("alpha_a", "alpha_p")]
            assert float(row["steady_state_error"]) == pytest.approx(max(errors), rel=1e-6)
            compared += 1
    assert longer == {f"xi_paper_rollouts_{count}" for count in (0, 400, 800)}
    assert compared >= 9


def test_figures_are_found_in_pairs_and_signs_and_not_in_code_or_names():
    text = "| `x=0.5` | .0006/.0011 (-2.5e-05), 1e-3 [0.1, 20] v1.2.3 8e10f03 a0.5 3 |"
    assert figures(text) == [".0006", ".0011", "-2.5e-05", "1e-3", "0.1"]


def test_a_changed_figure_of_a_page_is_left_over_and_a_changed_file_is_missed():
    page = "It ends at .004\nrad.\n\n| a | .0006 / .0011 |\n| b | 3.5 |\n"
    tie = Tie("page", "It ends at {} rad.", (".004",))
    row = Tie("page", "| a | {} |", (".0006 / .0011",))
    assert left_over(page, [tie.text, row.text]) == ["| b | 3.5 |"]
    assert left_over(page.replace(".004", ".005"), [tie.text, row.text])[0] == "It ends at .005 rad."
    assert Tie("page", tie.words, (".005",)).text not in flat(page)
