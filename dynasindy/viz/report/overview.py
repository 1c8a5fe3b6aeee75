"""What a reader sees first: what the paper claims, what of it holds here, and by which numbers that is said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dynasindy.viz.report.document import Cell, Finding, Link, Part, Section, Table, Text, Verdict
from dynasindy.viz.report.model_verdicts import MODEL
from dynasindy.viz.report.sources import CASES, PLANTS, REPORT, told
from dynasindy.viz.report.thresholds import THRESHOLDS
from dynasindy.viz.report.verdicts import EXACT, SOONER, WAVES

CLAIMS = (MODEL, SOONER, EXACT, WAVES)
HOLDS = (Verdict.AS, Verdict.BETTER)
COLUMNS = [told(*case) for case in CASES]
PAPER_EPISODES = 2500
"""Episodes after which the paper draws its controllers with a model."""
WORDS = (
    "The paper, Dyna-Style Reinforcement Learning Modeling and Control of Non-linear Dynamics, identifies a twin-rotor "
    "rig by SINDy and trains TD3 on the real rig and on imagined rollouts of the model. What follows is built by "
    f"`{REPORT}` from the results saved in the repository: `xi` is the paper's published model taken as a plant, "
    "`tras` the physics of its laboratory rig; `dyna` are our settings, `paper` the paper's. No statement is judged by "
    "hand."
)
MEANINGS = {
    Verdict.AS: "Our numbers show what the paper's figure or table shows.",
    Verdict.BETTER: "They do not show it because ours is better in the very sense of the statement, which so no longer "
    "applies.",
    Verdict.SHORT: "Our runs, as long as they are, do not show it, and are not better either.",
    Verdict.UNKNOWN: "No saved result says anything about it: a line in its section says which command would, or a "
    "number that it compares is not finite.",
}


def overview(sections: Sequence[Section], lengths: Mapping[str, str]) -> list[Section]:
    """Return the sections that stand first.

    Args:
        sections: All others.
        lengths: Real episodes of the runs in words, by their cases.
    """
    places = [(finding, section.title) for section in sections for finding in section.findings]
    return [
        Section("The verdict", [Text(WORDS), *_claims(places, lengths)]),
        Section("Every statement of the paper", _statements(sections)),
        Section("How a verdict is given", _rules()),
    ]


def holds(findings: Sequence[Finding]) -> str:
    """Return in words how much of a claim holds; a claim does if each of its statements is measured and does."""
    unknown = sum(finding.verdict is Verdict.UNKNOWN for finding in findings)
    if unknown == len(findings):
        return Verdict.UNKNOWN.value
    count = sum(finding.verdict in HOLDS for finding in findings)
    share = f"({count} of {len(findings)}" + (f", {unknown} not measured)" if unknown else ")")
    return f"holds {share}" if count == len(findings) else f"in part {share}" if count else f"not reached {share}"


def _claims(places: Sequence[tuple[Finding, str]], lengths: Mapping[str, str]) -> list[Part]:
    rows: list[list[Cell]] = []
    full: dict[str, int] = dict.fromkeys(COLUMNS, 0)
    for claim in CLAIMS:
        row: list[Cell] = [claim]
        for case in COLUMNS:
            of = [(finding, title) for finding, title in places if (finding.claim, finding.case) == (claim, case)]
            words = holds([finding for finding, _ in of])
            full[case] += words.startswith("holds")
            # The evidence: where it falls short first, as that is what a reader asks about.
            short = [title for finding, title in of if finding.verdict is Verdict.SHORT]
            row.append(Link(words, (short or [of[0][1]])[0]) if of else words)
        rows.append(row)
    counts = "; ".join(
        f"with {words} {' and '.join(_count(full, lengths, plant, experiment) for plant in PLANTS)}"
        for experiment, words in (("dyna", "our settings"), ("paper", "the paper's settings"))
    )
    return [
        Text(
            f"**The paper makes {len(CLAIMS)} claims. So many of them hold here in full: {counts}.** The paper's "
            f"controllers with a model have learnt for {PAPER_EPISODES} episodes; what `paper` does not reach here it "
            "does not reach in the episodes of these runs. Each cell leads to its evidence, and says how many of "
            "the statements behind it hold."
        ),
        Table(["what the paper claims, in our words", *COLUMNS], rows),
    ]


def _count(full: Mapping[str, int], lengths: Mapping[str, str], plant: str, experiment: str) -> str:
    """Return how many claims hold in full in a case, and after how many episodes."""
    case = told(plant, experiment)
    return f"{full[case] or 'none'} on `{plant}`" + (f" ({lengths[case]})" if case in lengths else "")


def _statements(sections: Sequence[Section]) -> list[Part]:
    rows: list[list[Cell]] = []
    for section in sections:
        if section.title.startswith("Beyond"):
            continue
        number = section.title.partition(":")[0]
        if not section.findings:
            rows.append([Link(number, section.title), "no statement to compare", *["-"] * len(COLUMNS)])
        for paper in dict.fromkeys(finding.paper for finding in section.findings):
            found = {finding.case: finding.verdict.value for finding in section.findings if finding.paper == paper}
            rows.append([Link(number, section.title), paper, *(found.get(case, "-") for case in COLUMNS)])
    verdicts = [finding.verdict for section in sections for finding in section.findings]
    counts = ", ".join(f"{verdicts.count(verdict)} {verdict.value}" for verdict in Verdict)
    words = (
        f"Of {len(verdicts)} comparisons: {counts}. A dash: the statement is of another experiment. The first column "
        "leads to the numbers, the figures, and the command and commit of each run."
    )
    return [Text(words), Table(["evidence", "what the paper shows", *COLUMNS], rows)]


def _rules() -> list[Part]:
    meanings = [[verdict.value, words] for verdict, words in MEANINGS.items()]
    numbers = [[f"{one.value:g} {one.unit}", one.words] for one in THRESHOLDS.values()]
    return [
        Table(["verdict", "what it means"], meanings),
        Text("These numbers decide, and no others; each is tested from both sides."),
        Table(["threshold", "what it decides"], numbers),
    ]
