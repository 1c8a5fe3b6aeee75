"""The report: every figure and table of the paper beside ours, from saved results, and what holds of its claims."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from dynasindy.safe_io import reading, write_text
from dynasindy.viz.report.document import (
    Finding,
    Link,
    Part,
    Picture,
    Section,
    TextTable,
    Verdict,
    render_markdown,
)
from dynasindy.viz.report.paper import CLAIMS, EPISODES, THRESHOLDS
from dynasindy.viz.report.results import CASES, PLANTS, REPORT, MissingResult, Results, case_name
from dynasindy.viz.report.sections import SECTIONS

__all__ = ["SECTIONS", "TITLE", "Results", "build", "pages"]

TITLE = "The paper's figures and tables, beside ours"
COLUMNS = [case_name(*case) for case in CASES]
MEANINGS = {
    Verdict.HOLDS: "Our numbers show what the paper's figure or table shows.",
    Verdict.SAME: "Ours are both as good as the thresholds ask for, and not better one than the other as in the paper.",
    Verdict.SHORT: "Our runs, as long as they are, do not show it.",
    Verdict.UNKNOWN: "No saved result says anything about it, or a number that it compares is not finite.",
}


def build(results: Results, folder: Path) -> list[Path]:
    """Write `report.md` with `figures/`, and return the files.

    Raises:
        DamagedFileError: A saved file is not what a section expects.
    """
    page = pages(results)
    files = {folder / "report.md": render_markdown(TITLE, page)}
    for part in (part for section in page for part in section.parts):
        if isinstance(part, Picture):
            files[folder / "figures" / f"{part.name}.svg"] = part.svg() + "\n"
    for file, text in files.items():
        write_text(file, text)
    return [*files]


def pages(results: Results) -> list[Section]:
    """Return the sections from top to bottom: the verdict, the paper in its order, and what is beyond it."""
    with reading(results.folder):
        sections = [entry.section(results) for entry in SECTIONS]
        return [_claims(sections, results), _rules(), *sections]


def _claims(sections: Sequence[Section], results: Results) -> Section:
    rows: list[list[str | Link]] = []
    full = dict.fromkeys(COLUMNS, 0)
    for claim in CLAIMS:
        row: list[str | Link] = [claim]
        for case in COLUMNS:
            evidence = [
                (finding, section.title)
                for section in sections
                for finding in section.findings
                if (finding.statement.claim, finding.case) == (claim, case)
            ]
            words = _share([finding for finding, _ in evidence])
            full[case] += words.startswith("holds")
            # A reader asks first where it falls short.
            evidence.sort(key=lambda pair: pair[0].verdict is not Verdict.SHORT)
            row.append(Link(words, evidence[0][1]) if evidence else words)
        rows.append(row)
    counts = "; ".join(
        f"with {words} "
        + " and ".join(f"{full[case_name(plant, one)] or 'none'} {_ran(results, plant, one)}" for plant in PLANTS)
        for one, words in (("dyna", "our settings"), ("paper", "the paper's settings"))
    )
    verdicts = [finding.verdict for section in sections for finding in section.findings]
    about = (
        "The paper, Dyna-Style Reinforcement Learning Modeling and Control of Non-linear Dynamics, identifies a "
        "twin-rotor rig by SINDy and trains TD3 on the real rig and on imagined rollouts of the model. What "
        f"follows is built by `{REPORT}` from the results saved in the repository: `xi` is the paper's published "
        "model taken as a plant, `tras` the physics of its laboratory rig; `dyna` are our settings, `paper` the "
        "paper's. No statement is judged by hand."
    )
    words = (
        f"**The paper makes {len(CLAIMS)} claims. So many of them hold here in full: {counts}.** The paper's "
        f"controllers with a model have learnt for {EPISODES} episodes; what `paper` does not reach here it does not "
        "reach in the episodes of these runs. Each cell leads to its evidence, and says how many of the statements "
        f"behind it hold. Of {len(verdicts)} statements in all {verdicts.count(Verdict.HOLDS)} hold."
    )
    return Section(
        "The verdict", about, [], [words, TextTable(["what the paper claims, in our words", *COLUMNS], rows)]
    )


def _share(findings: Sequence[Finding]) -> str:
    """Return in words how much of a claim holds; a claim does if each of its statements is measured and does."""
    verdicts = [finding.verdict for finding in findings]
    unknown, count = verdicts.count(Verdict.UNKNOWN), verdicts.count(Verdict.HOLDS)
    if unknown == len(findings):
        return Verdict.UNKNOWN.value
    part = count or Verdict.SAME in verdicts
    words = "holds" if count == len(findings) else "in part" if part else "not reached"
    others = ((verdicts.count(one), one.value) for one in (Verdict.SAME, Verdict.UNKNOWN))
    rest = "".join(f", {number} {what}" for number, what in others if number)
    return f"{words} ({count} of {len(findings)}{rest})"


def _ran(results: Results, plant: str, experiment: str) -> str:
    """Return a plant, and after how many real episodes its runs ended."""
    with suppress(MissingResult):
        return f"on `{plant}` ({results.episodes(plant, experiment)})"
    return f"on `{plant}`"


def _rules() -> Section:
    meanings = TextTable(["verdict", "what it means"], [[one.value, words] for one, words in MEANINGS.items()])
    numbers = [[f"{one.value:g} {one.unit}", one.words] for one in THRESHOLDS]
    words = "These numbers decide, and no others; each is tested from both sides."
    parts: list[Part] = [meanings, words, TextTable(["threshold", "what it decides"], numbers)]
    return Section("How a verdict is given", "", [], parts)
