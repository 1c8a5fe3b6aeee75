"""A page of words, tables, figures and findings, written as Markdown beside its figures and as one HTML file.

Words may hold `code` and **bold**; all else is shown as it stands, and is neither HTML nor a link.
"""

from __future__ import annotations

import io
import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, ClassVar

import jinja2
import matplotlib
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from dynasindy.safe_io import escape_markdown, file_name, write_text
from dynasindy.viz.style import STYLE, save


class Verdict(Enum):
    """How ours stands to a statement of the paper."""

    AS = "as in the paper"
    BETTER = "better than the paper"
    SHORT = "not reached"
    UNKNOWN = "not measured"


COLOURS = {
    Verdict.AS.value: "good",
    Verdict.BETTER.value: "better",
    Verdict.SHORT.value: "short",
    "holds": "good",
    "in part": "part",
}
"""Class of a cell that begins with a verdict."""
WIDTH = 120
SVG: dict[Any, Any] = {"svg.fonttype": "none", "path.simplify_threshold": 0.3}
"""Letters stay text, which is smaller than outlines and can be searched."""


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    kind: ClassVar[str] = "text"
    words: str


@dataclass(frozen=True)
class Link:
    """Words in a table that lead to a section of the page, by its title."""

    words: str
    title: str


@dataclass(frozen=True)
class Table:
    """A table of words, a row per entry of `rows`."""

    kind: ClassVar[str] = "table"
    header: Sequence[str]
    rows: Sequence[Sequence[str | Link]]


@dataclass(frozen=True)
class Listing:
    """Lines that keep their shape, such as equations."""

    kind: ClassVar[str] = "listing"
    lines: Sequence[str]


@dataclass(frozen=True)
class Picture:
    """A figure, the name of its files, what it shows, and the command and commit that it comes from."""

    kind: ClassVar[str] = "picture"
    name: str
    figure: Figure
    caption: str
    source: str = ""

    def __post_init__(self) -> None:
        file_name(self.name, "figure")


@dataclass(frozen=True)
class Statement:
    """What a figure of the paper shows, and what the paper claims by it, if it is one of its claims."""

    words: str
    claim: str = ""


@dataclass(frozen=True)
class Finding:
    """A statement of the paper, the plant and experiment it is compared in, ours in numbers, and the verdict."""

    statement: Statement
    case: str
    ours: str = "no saved result"
    verdict: Verdict = Verdict.UNKNOWN


Part = Text | Table | Listing | Picture | Finding


@dataclass
class Section:
    """A heading and what stands under it; neighbouring findings are shown as one table."""

    title: str
    parts: list[Part] = field(default_factory=list)

    @property
    def findings(self) -> list[Finding]:
        """The findings among the parts."""
        return [part for part in self.parts if isinstance(part, Finding)]

    @property
    def shown(self) -> list[Part]:
        """The parts, each run of findings as one table."""
        parts: list[Part] = []
        rows: list[Sequence[str]] = []
        for part in self.parts:
            if isinstance(part, Finding):
                if not rows:
                    parts.append(Table(["plant, experiment", "the paper", "ours", "verdict"], rows))
                rows.append([part.case, part.statement.words, part.ours, part.verdict.value])
            else:
                rows = []
                parts.append(part)
        return parts


def _anchor(title: str) -> str:
    """Return the name of a heading that links use, the one that GitHub gives it."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def render_markdown(title: str, sections: Sequence[Section], suffix: str = "svg", html: str = "") -> str:
    """Return a page as Markdown, whose figures are `figures/NAME.suffix`.

    Args:
        title: of the page.
        sections: What stands on it.
        suffix: File format of the figures.
        html: Name of a file beside it that holds the same as HTML.
    """
    lines = [f"# {title}", ""]
    if html:
        lines += [f"[The same as one HTML file]({html}) needs no other file.", ""]
    for section in sections:
        lines += [f"## {section.title}", ""]
        for part in section.shown:
            lines += [_markdown(part, suffix), ""]
    return "\n".join(lines).rstrip() + "\n"


def render_html(title: str, sections: Sequence[Section]) -> str:
    """Return a page as HTML that needs no other file and no network, its figures inline."""
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    page = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    page.filters |= {"inline": _inline, "anchor": _anchor, "colour": _colour, "svg": _svg_markup}
    return page.get_template("template.html").render(title=title, sections=sections)


def write_figures(sections: Iterable[Section], folder: Path, formats: Sequence[str]) -> list[Path]:
    """Write the figures of a page and return the files."""
    files = []
    pictures = [part for section in sections for part in section.parts if isinstance(part, Picture)]
    for picture in pictures:
        for suffix in formats:
            file = folder / f"{picture.name}.{suffix}"
            files.append(file)
            if suffix == "svg":
                write_text(file, _svg(picture.figure, picture.name) + "\n")
            else:
                save(picture.figure, file.with_suffix(""), [suffix])
    return files


def _svg(figure: Figure, name: str) -> str:
    """Return a figure as an SVG element on one line, without metadata, names of groups and digits below 0.1 pt.

    Args:
        figure: What to draw.
        name: Makes its ids differ from those of other figures of a page.
    """
    file = io.StringIO()
    with matplotlib.rc_context({**STYLE, **SVG, "svg.hashsalt": name}):
        figure.savefig(file, format="svg", metadata={"Date": None})
    element = file.getvalue()
    element = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", element[element.index("<svg") :], flags=re.S)
    element = re.sub(r'<g id="[^"]*"', "<g", element)
    element = re.sub(r' (?:d|x|y)="[^"]+"', lambda outline: _rounded(outline[0]), element)
    return re.sub(r"\s*\n\s*", " ", element).strip()


def _rounded(outline: str) -> str:
    short = re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.1f}".removesuffix(".0"), outline)
    return re.sub(r"\s*([MLQCz])\s*", r"\1", short).replace(' "', '"')


def _svg_markup(figure: Figure, name: str) -> Markup:
    return Markup(_svg(figure, name))  # matplotlib escapes labels


def _inline(words: str) -> Markup:
    """Return words with their `code` and **bold** as HTML."""
    code = re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(words)))
    return Markup(re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", code))


def _colour(cell: str) -> str:
    """Return the class of a cell; empty where it is no verdict."""
    return COLOURS.get(cell.partition(" (")[0], "")


def _markdown(part: Part, suffix: str) -> str:
    if isinstance(part, Table):
        rows = [[_cell(cell) for cell in row] for row in (part.header, ["---"] * len(part.header), *part.rows)]
        return "\n".join(f"| {' | '.join(row)} |" for row in rows)
    if isinstance(part, Listing):
        # A line break within a line would end the code block.
        return "\n".join(f"    {' '.join(line.splitlines())}" for line in part.lines)
    if isinstance(part, Picture):
        alt = part.caption.partition(". ")[0].removesuffix(".").replace("`", "").replace("[", "(").replace("]", ")")
        words = escape_markdown(f"{part.caption} {part.source}".strip())
        return f"![{escape_markdown(alt)}](figures/{part.name}.{suffix})\n\n{_wrapped(words)}"
    return _wrapped(escape_markdown(part.words if isinstance(part, Text) else part.ours))


def _cell(cell: str | Link) -> str:
    words = escape_markdown(cell.words if isinstance(cell, Link) else cell).replace("|", r"\|")
    return f"[{words}](#{_anchor(cell.title)})" if isinstance(cell, Link) else words


def _wrapped(words: str) -> str:
    return "\n".join(textwrap.wrap(words, WIDTH, break_long_words=False, break_on_hyphens=False))
