"""A page of sections with words, tables and figures, written as Markdown with figure files.

Words may hold `code` and **bold**; all else is shown as it stands, and is neither HTML nor a link.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

from matplotlib.figure import Figure

from dynasindy.evaluation.given import escaped, plain_name
from dynasindy.evaluation.table import markdown
from dynasindy.viz.report.vector import write_figure


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    words: str


@dataclass(frozen=True)
class Link:
    """Words in a table that lead to a section of the page, by its title."""

    words: str
    title: str


Cell = str | Link


@dataclass(frozen=True)
class Table:
    """A table of words, a row per entry of `rows`."""

    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]


@dataclass(frozen=True)
class Listing:
    """Lines that keep their shape, such as equations."""

    lines: Sequence[str]


@dataclass(frozen=True)
class Picture:
    """A figure, the name of its files, what it shows, and the command and commit that it comes from."""

    name: str
    figure: Figure
    caption: str
    source: str = ""

    def __post_init__(self) -> None:
        plain_name(self.name, "figure")


class Verdict(Enum):
    """How ours stands to a statement of the paper."""

    AS = "as in the paper"
    BETTER = "better than the paper"
    SHORT = "not reached"
    UNKNOWN = "not measured"


@dataclass(frozen=True)
class Finding:
    """Something that a figure of the paper shows, ours in numbers, and the verdict.

    Attributes:
        case: Plant and experiment.
        paper: What the paper shows.
        ours: Ours, in numbers.
        verdict: Whether they agree.
        claim: What the paper claims by it, if it is one of its claims.
    """

    case: str
    paper: str
    ours: str
    verdict: Verdict = Verdict.UNKNOWN
    claim: str = ""


@dataclass(frozen=True)
class Statement:
    """What a figure of the paper shows, and what it claims by it, if it is one of its claims."""

    words: str
    claim: str = ""

    def of(self, case: str, ours: str, verdict: Verdict) -> Finding:
        """Return what is found of it in a case."""
        return Finding(case, self.words, ours, verdict, self.claim)

    def unmeasured(self, case: str) -> Finding:
        """Return that nothing saved says anything of it in a case."""
        return self.of(case, "no saved result", Verdict.UNKNOWN)


Part = Text | Table | Listing | Picture | Finding
WIDTH = 120
FINDINGS = ("plant, experiment", "the paper", "ours", "verdict")


@dataclass
class Section:
    """A heading and what stands under it; neighbouring findings are written as one table."""

    title: str
    parts: list[Part] = field(default_factory=list)

    @property
    def anchor(self) -> str:
        """The name that links within the page use."""
        return anchor(self.title)

    @property
    def findings(self) -> list[Finding]:
        """The findings among the parts."""
        return [part for part in self.parts if isinstance(part, Finding)]


def anchor(title: str) -> str:
    """Return the name of a heading that links use, the one that GitHub gives it."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def write_markdown(
    title: str, sections: Sequence[Section], path: Path, formats: Sequence[str], same: str = ""
) -> list[Path]:
    """Write a page as Markdown and its figures into `figures/` beside it; return all files.

    Args:
        title: of the page.
        sections: What stands on it.
        path: Where.
        formats: File formats of the figures, the one that it shows first.
        same: Name of a file beside it that holds the same as HTML, to which its first line leads.
    """
    lines, files = [f"# {title}", ""], [path]
    if same:
        lines += [_wrapped(f"[The same as one HTML file]({same}) needs no other file and has figures to zoom."), ""]
    for section in sections:
        lines += [f"## {section.title}", ""]
        for part in joined(section.parts):
            if isinstance(part, Picture):
                names = [path.parent / "figures" / f"{part.name}.{suffix}" for suffix in formats]
                files += [write_figure(part.figure, part.name, file) for file in names]
            lines += [_markdown(part, formats), ""]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    return files


def joined(parts: Iterable[Part]) -> list[Part]:
    """Return the parts with each run of findings as one table."""
    found: list[Part] = []
    rows: list[Sequence[Cell]] = []
    for part in parts:
        if isinstance(part, Finding):
            if not rows:
                found.append(Table(FINDINGS, rows))
            rows.append([part.case, part.paper, part.ours, part.verdict.value])
        else:
            rows = []
            found.append(part)
    return found


def _markdown(part: Part, formats: Sequence[str]) -> str:
    if isinstance(part, Table):
        return _table(part)
    if isinstance(part, Listing):
        # A line break within a line would end the code block.
        return "\n".join(f"    {' '.join(line.splitlines())}" for line in part.lines)
    if isinstance(part, Picture):
        alt = part.caption.partition(". ")[0].removesuffix(".").replace("`", "").replace("[", "(").replace("]", ")")
        words = f"{part.caption} {part.source}".strip()
        return f"![{escaped(alt)}](figures/{part.name}.{formats[0]})\n\n{_wrapped(escaped(words))}"
    return _wrapped(escaped(part.words if isinstance(part, Text) else part.ours))


def _table(part: Table) -> str:
    """Return a table whose links, unlike the words of others, lead somewhere."""
    links = [cell for row in part.rows for cell in row if isinstance(cell, Link)]
    places = iter(range(len(links)))
    text = markdown(
        part.header, [[f"\ue000{next(places)}\ue001" if isinstance(c, Link) else c for c in row] for row in part.rows]
    )
    for place, link in enumerate(links):
        words = escaped(link.words).replace("|", r"\|")
        text = text.replace(f"\ue000{place}\ue001", f"[{words}](#{anchor(link.title)})", 1)
    return text


def _wrapped(words: str) -> str:
    """Return a paragraph in lines that a reader of the source can take in."""
    return "\n".join(textwrap.wrap(words, WIDTH, break_long_words=False, break_on_hyphens=False))
