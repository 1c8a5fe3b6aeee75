"""A page of sections with words, tables and figures, written as one HTML file and as Markdown with figure files.

Words may hold `code` and **bold**; all else is shown as it stands, and is neither HTML nor a link.
"""

from __future__ import annotations

import html
import io
import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure
from PIL import Image

from dynasindy.evaluation.given import escaped, plain_name
from dynasindy.evaluation.table import markdown
from dynasindy.viz.style import STYLE, save


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    words: str


@dataclass(frozen=True)
class Table:
    """A table of words, a row per entry of `rows`."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Listing:
    """Lines that keep their shape, such as equations."""

    lines: Sequence[str]


@dataclass(frozen=True)
class Picture:
    """A figure, the name of its files, and what it shows and comes from."""

    name: str
    figure: Figure
    caption: str

    def __post_init__(self) -> None:
        plain_name(self.name, "figure")


@dataclass(frozen=True)
class Finding:
    """Something a figure of the paper shows, ours in numbers, and whether they agree; None is not measured."""

    paper: str
    ours: str
    agrees: bool | None = None


Part = Text | Table | Listing | Picture | Finding
VERDICT = {True: "yes", False: "no", None: "not measured"}
WIDTH = 120
FINDINGS = ("the paper", "ours", "agrees")


@dataclass
class Section:
    """A heading and what stands under it; neighbouring findings are written as one table."""

    title: str
    parts: list[Part] = field(default_factory=list)

    @property
    def anchor(self) -> str:
        """The name that links within the page use."""
        return re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")

    @property
    def findings(self) -> list[Finding]:
        """The findings among the parts."""
        return [part for part in self.parts if isinstance(part, Finding)]


def write_markdown(title: str, sections: Sequence[Section], path: Path, formats: Sequence[str]) -> list[Path]:
    """Write a page as Markdown and its figures into `figures/` beside it; return all files."""
    lines, files = [f"# {title}", ""], [path]
    for section in sections:
        lines += [f"## {section.title}", ""]
        for part in _joined(section.parts):
            if isinstance(part, Picture):
                files += [_save(part, path.parent / "figures" / f"{part.name}.{suffix}") for suffix in formats]
            lines += [_markdown(part, formats), ""]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines).rstrip() + "\n")
    return files


def write_html(title: str, sections: Sequence[Section], path: Path) -> Path:
    """Write a page as one HTML file that needs no other file and no network, its figures as vectors."""
    links = "".join(f'<li><a href="#{s.anchor}">{html.escape(s.title)}</a></li>' for s in sections)
    drawn: set[str] = set()
    body = [f"<h1>{html.escape(title)}</h1>", f"<nav><ul>{links}</ul></nav>"]
    for section in sections:
        body.append(f'<section id="{section.anchor}"><h2>{html.escape(section.title)}</h2>')
        body += [_html(part, drawn) for part in _joined(section.parts)]
        body.append("</section>")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(PAGE.format(title=html.escape(title), body="\n".join(body)))
    return path


def svg(figure: Figure, name: str, drawn: set[str] | None = None) -> str:
    """Return a figure as a small SVG element.

    Args:
        figure: What to draw.
        name: Begins its ids, so that several share a page.
        drawn: Letters that the page has drawn already, which are left out; those of this figure are added.
    """
    element = re.sub(r'(\bid="|href="#|url\(#)(?!DejaVu)', rf"\g<1>{name}-", _svg(figure))
    known: set[str] = set() if drawn is None else drawn

    def _once(letter: re.Match[str]) -> str:
        new = letter[1] not in known
        known.add(letter[1])
        return letter[0] if new else ""

    return re.sub(r'<path id="(DejaVu[^"]+)"[^>]*/>\n', _once, element)


@cache
def _svg(figure: Figure) -> str:
    """Draw a figure once for both pages, without what nobody sees."""
    file = io.StringIO()
    with matplotlib.rc_context({**STYLE, "path.simplify_threshold": 0.3}):
        figure.savefig(file, format="svg", metadata={"Date": None})
    element = file.getvalue()
    element = element[element.index("<svg") :]
    element = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", element, flags=re.S)
    element = re.sub(r' d="[^"]+"', lambda outline: _rounded(outline[0]), element)
    return re.sub(r"\s*\n\s*", "\n", element)


def _rounded(outline: str) -> str:
    """Round the points of an outline to a tenth of a point, finer than a screen shows."""
    short = re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.1f}".removesuffix(".0"), outline)
    return re.sub(r"\s*([MLQCz])\s*", r"\1", short).replace(' "', '"')


def _save(part: Picture, path: Path) -> Path:
    """Write a figure as a small file: outlines rounded, or pixels of 64 colours."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".svg":
        path.write_text(svg(part.figure, part.name) + "\n")
    elif path.suffix == ".png":
        file = io.BytesIO()
        with matplotlib.rc_context(STYLE):
            part.figure.savefig(file, format="png", dpi=100)
        Image.open(file).convert("RGB").quantize(64, dither=Image.Dither.NONE).save(path, optimize=True)
    else:
        save(part.figure, path.with_suffix(""), [path.suffix[1:]])
    return path


def _joined(parts: Iterable[Part]) -> list[Part]:
    """Return the parts with each run of findings as one table."""
    joined: list[Part] = []
    rows: list[Sequence[str]] = []
    for part in parts:
        if isinstance(part, Finding):
            if not rows:
                joined.append(Table(FINDINGS, rows))
            rows.append([part.paper, part.ours, VERDICT[part.agrees]])
        else:
            rows = []
            joined.append(part)
    return joined


def _markdown(part: Part, formats: Sequence[str]) -> str:
    if isinstance(part, Table):
        return markdown(part.header, part.rows)
    if isinstance(part, Listing):
        # A line break within a line would end the code block.
        return "\n".join(f"    {' '.join(line.splitlines())}" for line in part.lines)
    if isinstance(part, Picture):
        alt = part.caption.partition(". ")[0].replace("`", "").replace("[", "(").replace("]", ")")
        return f"![{escaped(alt)}](figures/{part.name}.{formats[0]})\n\n{_wrapped(escaped(part.caption))}"
    return _wrapped(escaped(part.words if isinstance(part, Text) else part.ours))


def _wrapped(words: str) -> str:
    """Return a paragraph in lines that a reader of the source can take in."""
    return "\n".join(textwrap.wrap(words, WIDTH, break_long_words=False, break_on_hyphens=False))


def _html(part: Part, drawn: set[str]) -> str:
    if isinstance(part, Table):
        head = "".join(f"<th>{_inline(cell)}</th>" for cell in part.header)
        rows = "".join("<tr>" + "".join(_cell(cell) for cell in row) + "</tr>" for row in part.rows)
        return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>'
    if isinstance(part, Listing):
        return f"<pre>{html.escape(chr(10).join(part.lines))}</pre>"
    if isinstance(part, Picture):
        return f"<figure>{svg(part.figure, part.name, drawn)}<figcaption>{_inline(part.caption)}</figcaption></figure>"
    return f"<p>{_inline(part.words if isinstance(part, Text) else part.ours)}</p>"


def _cell(cell: str) -> str:
    mark = {"yes": ' class="yes"', "no": ' class="no"'}.get(cell, "")
    return f"<td{mark}>{_inline(cell)}</td>"


def _inline(words: str) -> str:
    escaped = re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(words, quote=False))
    return re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", escaped)


PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; color: #1e1e1e; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }}
h2 {{ margin-top: 3rem; border-bottom: 1px solid #d9d9d9; padding-bottom: .3rem; }}
nav ul {{ columns: 2; padding-left: 1.2rem; }}
figure {{ margin: 1.5rem 0; }}
figcaption {{ color: #555; font-size: .9rem; }}
svg {{ max-width: 100%; height: auto; }}
.wide {{ overflow-x: auto; margin: 1rem 0; }}
table {{ border-collapse: collapse; font-size: .9rem; }}
th, td {{ border: 1px solid #d9d9d9; padding: .3rem .6rem; text-align: left; vertical-align: top; }}
th {{ background: #f4f6f8; }}
td.yes {{ color: #00664a; font-weight: 600; }}
td.no {{ color: #a84500; font-weight: 600; }}
pre {{ background: #f4f6f8; padding: .8rem; overflow-x: auto; font-size: .85rem; }}
code {{ background: #f4f6f8; padding: 0 .2rem; font-size: .9em; overflow-wrap: anywhere; }}
</style>
</head>
<body>
{body}
</body>
</html>
"""
