import pytest

from dynasindy.viz.report.document import Finding, Link, Section, Table, Text, Verdict, anchor
from dynasindy.viz.report.model_verdicts import MODEL
from dynasindy.viz.report.overview import CLAIMS, COLUMNS, MEANINGS, holds, overview
from dynasindy.viz.report.thresholds import THRESHOLDS
from dynasindy.viz.report.verdicts import SOONER

AS, BETTER, SHORT, UNKNOWN = Verdict
XI, TRAS = COLUMNS[0], COLUMNS[2]


def of(*verdicts: Verdict) -> list[Finding]:
    return [Finding(XI, "s", "o", verdict) for verdict in verdicts]


@pytest.mark.parametrize(
    ("verdicts", "words"),
    [
        ((AS, BETTER), "holds (2 of 2)"),
        ((AS, SHORT), "in part (1 of 2)"),
        ((SHORT, SHORT, UNKNOWN), "not reached (0 of 3, 1 not measured)"),
        ((AS, UNKNOWN, BETTER), "in part (2 of 3, 1 not measured)"),
        ((UNKNOWN, UNKNOWN), "not measured"),
        ((UNKNOWN,), "not measured"),
        ((), "not measured"),
    ],
)
def test_a_claim_holds_if_each_of_its_statements_is_measured_and_does(verdicts, words):
    assert holds(of(*verdicts)) == words


def sections() -> list[Section]:
    first = [Finding(XI, "a", "1", AS, MODEL), Finding(TRAS, "a", "2", SHORT, MODEL), Finding(XI, "b", "3", BETTER)]
    second = [Finding(XI, "c", "4", SHORT, MODEL), Finding(XI, "d", "5", AS, SOONER)]
    return [Section("Figure 1: one", first), Section("Figure 2: two", second), Section("Beyond the paper: x")]


def test_a_claim_with_a_statement_that_is_not_measured_does_not_hold_in_full():
    def words(*verdicts: Verdict) -> str:
        findings = [Finding(XI, f"{k}", "o", verdict, MODEL) for k, verdict in enumerate(verdicts)]
        return overview([Section("Figure 1: one", findings)], {})[0].parts[1].words

    assert "with our settings 1 on `xi`" in words(AS, BETTER)
    assert "with our settings none on `xi`" in words(AS, UNKNOWN)


def tables(section):
    return [part for part in section.parts if isinstance(part, Table)]


def test_claims_come_first_and_lead_to_what_falls_short():
    verdict, _, _ = overview(sections(), {XI: "20 episodes"})
    (table,) = tables(verdict)
    assert [row[0] for row in table.rows] == list(CLAIMS)
    assert table.rows[0][1] == Link("in part (1 of 2)", "Figure 2: two")
    assert table.rows[0][3] == Link("not reached (0 of 1)", "Figure 1: one")
    assert table.rows[1][1] == Link("holds (1 of 1)", "Figure 2: two") and table.rows[1][2] == "not measured"
    words = verdict.parts[1].words
    assert (
        "with our settings 1 on `xi` (20 episodes) and none on `tras`; with the paper's settings none on `xi`" in words
    )


def test_every_statement_has_a_line_that_leads_to_its_evidence():
    _, statements, _ = overview(sections(), {})
    (table,) = tables(statements)
    assert [(row[0], *row[1:4]) for row in table.rows] == [
        (Link("Figure 1", "Figure 1: one"), "a", "as in the paper", "-"),
        (Link("Figure 1", "Figure 1: one"), "b", "better than the paper", "-"),
        (Link("Figure 2", "Figure 2: two"), "c", "not reached", "-"),
        (Link("Figure 2", "Figure 2: two"), "d", "as in the paper", "-"),
    ]
    assert table.rows[0][4] == "not reached"
    assert statements.parts[0].words.startswith(
        "Of 5 comparisons: 2 as in the paper, 1 better than the paper, 2 not reached, 0 not measured."
    )
    assert all(anchor(row[0].title) in {section.anchor for section in sections()} for row in table.rows)


def test_the_words_and_the_numbers_behind_a_verdict_are_listed():
    *_, rules = overview([], {})
    meanings, numbers = tables(rules)
    assert [row[0] for row in meanings.rows] == [verdict.value for verdict in Verdict] and len(MEANINGS) == 4
    assert len(numbers.rows) == len(THRESHOLDS) and ["0.05 rad", THRESHOLDS["LEVEL"].words] in numbers.rows
    assert any(isinstance(part, Text) for part in rules.parts)
