"""A page of words, tables, figures and findings, written as Markdown beside its figures.

Words may hold `code` and **bold**; all else is shown as it stands, and is neither HTML nor a link.
"""

from __future__ import annotations

import io
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, NamedTuple

import matplotlib
from matplotlib.figure import Figure

from dynasindy.safe_io import escape_markdown, file_name
from dynasindy.viz.style import STYLE

WIDTH = 120
SVG: dict[Any, Any] = {"svg.fonttype": "none", "path.simplify_threshold": 0.3}
"""Letters stay text, which is smaller than outlines and can be searched."""


class Verdict(Enum):
    """How ours stands to a statement of the paper."""

    HOLDS = "holds"
    SAME = "no difference"
    SHORT = "not reached"
    UNKNOWN = "not measured"


class Statement(NamedTuple):
    """What a figure of the paper shows, and which of the paper's claims rests on it."""

    words: str
    claim: str


class Finding(NamedTuple):
    """Ours in numbers, the verdict, the statement that it is on, and the plant and experiment it is compared in."""

    ours: str = "no saved result"
    verdict: Verdict = Verdict.UNKNOWN
    statement: Statement = Statement("", "")
    case: str = ""


class Link(NamedTuple):
    """Words in a table that lead to a section of the page, by its title."""

    words: str
    title: str


@dataclass(frozen=True)
class TextTable:
    """A table of words, a row per entry of `rows`, and what its numbers come from, a line each."""

    header: Sequence[str]
    rows: Sequence[Sequence[str | Link]]
    source: str = ""


@dataclass(frozen=True)
class Picture:
    """A figure, the name of its files, what it shows, and the commands and commits that it comes from, a line each."""

    name: str
    figure: Figure
    caption: str
    source: str = ""

    def __post_init__(self) -> None:
        file_name(self.name, "figure")

    def svg(self) -> str:
        """Return an SVG element on one line, without metadata, names of groups and digits below 0.1 pt."""
        file = io.StringIO()
        with matplotlib.rc_context({**STYLE, **SVG, "svg.hashsalt": self.name}):  # ids differ from other figures'
            self.figure.savefig(file, format="svg", metadata={"Date": None})
        element = file.getvalue()
        element = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", element[element.index("<svg") :], flags=re.S)
        element = re.sub(r'<g id="[^"]*"', "<g", element)
        element = re.sub(r' (?:d|x|y)="[^"]+"', lambda outline: _round_digits(outline[0]), element)
        return re.sub(r"\s*\n\s*", " ", element).strip()


Part = str | TextTable | Picture


@dataclass
class Section:
    """A heading, a paragraph, figures, a table of findings, and the other parts that show them."""

    title: str
    words: str = ""
    findings: list[Finding] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)

    @property
    def content(self) -> list[Part]:
        """What stands under the heading, from top to bottom."""
        cases = list(dict.fromkeys(one.case for one in self.findings))
        cells: dict[str, dict[str, str]] = {}
        for one in self.findings:
            cells.setdefault(one.statement.words, {})[one.case] = f"{one.verdict.value} ({one.ours})"
        rows = [[words, *(of.get(case, "") for case in cases)] for words, of in cells.items()]
        table = [TextTable(["the paper", *cases], rows)] if rows else []
        figures = [part for part in self.parts if isinstance(part, Picture)]
        others = [part for part in self.parts if not isinstance(part, Picture)]
        return [*filter(None, [self.words]), *figures, *table, *others]


def render_markdown(title: str, sections: Sequence[Section]) -> str:
    """Return a page as Markdown, whose figures are `figures/NAME.svg`.

    What figures and tables come from stands once, in a numbered list at the end of the page.
    """
    blocks = [f"# {title}"]
    sources: dict[str, int] = {}
    for section in sections:
        blocks += [f"## {section.title}", *(_markdown(part, sources) for part in section.content)]
    if sources:
        blocks += ["## Sources", "\n".join(f"{n}. {escape_markdown(words)}" for words, n in sources.items())]
    return "\n\n".join(blocks) + "\n"


def _round_digits(outline: str) -> str:
    short = re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.1f}".removesuffix(".0"), outline)
    return re.sub(r"\s*([MLQCz])\s*", r"\1", short).replace(' "', '"')


def _markdown(part: Part, sources: dict[str, int]) -> str:
    """Return a part as Markdown, and add what it comes from to the sources."""
    if isinstance(part, str):
        words = textwrap.wrap(escape_markdown(part), WIDTH, break_long_words=False, break_on_hyphens=False)
        return "\n".join(words)
    numbers = [sources.setdefault(line, len(sources) + 1) for line in part.source.splitlines()]
    source = f"Source: {', '.join(map(str, numbers))}." if numbers else ""
    if isinstance(part, Picture):
        image = f"![{part.name.replace('_', ' ')}](figures/{part.name}.svg)"
        return f"{image}\n\n{_markdown(f'{part.caption} {source}'.strip(), sources)}"
    rows = [[_cell(cell) for cell in row] for row in (part.header, ["---"] * len(part.header), *part.rows)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows) + f"\n\n{source}" * bool(source)


def _cell(cell: str | Link) -> str:
    words = escape_markdown(cell.words if isinstance(cell, Link) else cell).replace("|", r"\|")
    if isinstance(cell, str):
        return words
    anchor = re.sub(r"[^a-z0-9]+", "-", cell.title.lower()).strip("-")  # which GitHub gives a heading
    return f"[{words}](#{anchor})"
