"""The report: every figure and table of the paper beside ours, from saved results, and what holds of its claims."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from dynasindy.safe_io import reading, write_text
from dynasindy.viz.report import beyond, paper, sections
from dynasindy.viz.report.document import (
    Finding,
    Link,
    Part,
    Section,
    Table,
    Text,
    Verdict,
    render_html,
    render_markdown,
    write_figures,
)
from dynasindy.viz.report.results import CASES, PLANTS, REPORT, MissingResult, Results, case_name, listed

__all__ = ["TITLE", "Results", "build", "pages"]

TITLE = "The paper's figures and tables, beside ours"
HOLDS = (Verdict.AS, Verdict.BETTER)
COLUMNS = [case_name(*case) for case in CASES]
MEANINGS = {
    Verdict.AS: "Our numbers show what the paper's figure or table shows.",
    Verdict.BETTER: "They do not show it because ours is better in the very sense of the statement, which so no longer "
    "applies.",
    Verdict.SHORT: "Our runs, as long as they are, do not show it, and are not better either.",
    Verdict.UNKNOWN: "No saved result says anything about it: a line in its section says which command would, or a "
    "number that it compares is not finite.",
}


def build(results: Results, folder: Path, formats: Sequence[str] = ("svg",)) -> list[Path]:
    """Write `report.html`, which needs no other file, and `report.md` with `figures/`.

    Args:
        results: Saved runs and tables.
        folder: Where; made if missing.
        formats: File formats of the figures of the Markdown page, the one it shows first.

    Returns:
        The files.

    Raises:
        ValueError: There is no format, or the first one cannot be shown by a Markdown page.
        DamagedFileError: A saved file is not what a section expects.
    """
    if not formats or formats[0] not in ("svg", "png") or not all(suffix.isalnum() for suffix in formats):
        raise ValueError(f"formats is {list(formats)}; a page shows svg or png, name one of them first")
    page = pages(results)
    html, markdown = folder / "report.html", folder / "report.md"
    write_text(html, render_html(TITLE, page))
    write_text(markdown, render_markdown(TITLE, page, formats[0], html.name))
    return [html, markdown, *write_figures(page, folder / "figures", formats)]


def pages(results: Results) -> list[Section]:
    """Return the sections from top to bottom: the verdict, the paper in its order, and what is beyond it."""
    with reading(results.folder):
        found = [
            sections.drawings(),
            sections.chirp(results),
            sections.training(results),
            sections.hyperparameters(results),
            sections.learning_progress(results),
            sections.states(results, "first"),
            sections.states(results, "last"),
            sections.coefficients(results),
            sections.rewards(results),
            sections.steps(results),
            sections.wave(results, "sine"),
            sections.wave(results, "square"),
            beyond.gradient(results),
            beyond.baselines(results),
            beyond.trust(results),
            beyond.identification(results),
            beyond.real_logs(results),
            beyond.margins(results),
            beyond.speed(results),
        ]
        return [_claims(found, results), _statements(found), _rules(), *found]


def _claim_holds(findings: Sequence[Finding]) -> str:
    """Return in words how much of a claim holds; a claim does if each of its statements is measured and does."""
    unknown = sum(finding.verdict is Verdict.UNKNOWN for finding in findings)
    if unknown == len(findings):
        return Verdict.UNKNOWN.value
    count = sum(finding.verdict in HOLDS for finding in findings)
    share = f"({count} of {len(findings)}" + (f", {unknown} not measured)" if unknown else ")")
    return f"holds {share}" if count == len(findings) else f"in part {share}" if count else f"not reached {share}"


def _claims(found: Sequence[Section], results: Results) -> Section:
    rows: list[list[str | Link]] = []
    full = dict.fromkeys(COLUMNS, 0)
    for claim in paper.CLAIMS:
        row: list[str | Link] = [claim]
        for case in COLUMNS:
            evidence = [
                (finding, section.title)
                for section in found
                for finding in section.findings
                if (finding.statement.claim, finding.case) == (claim, case)
            ]
            words = _claim_holds([finding for finding, _ in evidence])
            full[case] += words.startswith("holds")
            # A reader asks first where it falls short.
            titles = [title for finding, title in evidence if finding.verdict is Verdict.SHORT]
            titles += [title for _, title in evidence]
            row.append(Link(words, titles[0]) if titles else words)
        rows.append(row)
    counts = "; ".join(
        f"with {words} "
        + " and ".join(f"{full[case_name(plant, one)] or 'none'} {_ran(results, plant, one)}" for plant in PLANTS)
        for one, words in (("dyna", "our settings"), ("paper", "the paper's settings"))
    )
    parts: list[Part] = [
        Text(
            "The paper, Dyna-Style Reinforcement Learning Modeling and Control of Non-linear Dynamics, identifies a "
            "twin-rotor rig by SINDy and trains TD3 on the real rig and on imagined rollouts of the model. What "
            f"follows is built by `{REPORT}` from the results saved in the repository: `xi` is the paper's published "
            "model taken as a plant, `tras` the physics of its laboratory rig; `dyna` are our settings, `paper` the "
            "paper's. No statement is judged by hand."
        ),
        Text(
            f"**The paper makes {len(paper.CLAIMS)} claims. So many of them hold here in full: {counts}.** The paper's "
            f"controllers with a model have learnt for {paper.EPISODES} episodes; what `paper` does not reach here it "
            "does not reach in the episodes of these runs. Each cell leads to its evidence, and says how many of "
            "the statements behind it hold."
        ),
        Table(["what the paper claims, in our words", *COLUMNS], rows),
    ]
    return Section("The verdict", parts)


def _ran(results: Results, plant: str, experiment: str) -> str:
    """Return a plant, and after how many real episodes its runs ended: those of figure 11, and the saved ones."""
    words = f"on `{plant}`"
    with suppress(MissingResult):
        saved = results.ablation_run(plant, experiment, "rollouts_800").episodes
        curves = results.lengths(plant, experiment) or [saved]
        other = f"{listed(curves)} episodes in figure 11, {saved} elsewhere"
        return f"{words} ({f'{saved} episodes' if curves == [saved] else other})"
    return words


def _statements(found: Sequence[Section]) -> Section:
    rows: list[list[str | Link]] = []
    for section in found:
        if section.title.startswith("Beyond"):
            continue
        link = Link(section.title.partition(":")[0], section.title)
        if not section.findings:
            rows.append([link, "no statement to compare", *["-"] * len(COLUMNS)])
        for statement in dict.fromkeys(finding.statement for finding in section.findings):
            own = {one.case: one.verdict.value for one in section.findings if one.statement == statement}
            rows.append([link, statement.words, *(own.get(case, "-") for case in COLUMNS)])
    verdicts = [finding.verdict for section in found for finding in section.findings]
    counts = ", ".join(f"{verdicts.count(verdict)} {verdict.value}" for verdict in Verdict)
    words = (
        f"Of {len(verdicts)} comparisons: {counts}. A dash: the statement is of another experiment. The first column "
        "leads to the numbers, the figures, and the command and commit of each run."
    )
    table = Table(["evidence", "what the paper shows", *COLUMNS], rows)
    return Section("Every statement of the paper", [Text(words), table])


def _rules() -> Section:
    meanings = [[verdict.value, words] for verdict, words in MEANINGS.items()]
    numbers = [[f"{one.value:g} {one.unit}", one.words] for one in paper.THRESHOLDS]
    parts: list[Part] = [
        Table(["verdict", "what it means"], meanings),
        Text("These numbers decide, and no others; each is tested from both sides."),
        Table(["threshold", "what it decides"], numbers),
    ]
    return Section("How a verdict is given", parts)
