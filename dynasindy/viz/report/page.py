"""The report as one HTML file that needs no other file and no network.

Figures are vectors that any browser shows; the scripts beside this module draw them again from their numbers, with
zoom, read-out and switches. The page allows itself these scripts and no other, and no address outside itself.

Words hold no Markdown but `code` and **bold**, which are two lines here. A package for Markdown would be one more that
every installation needs, and it would let the HTML and the links of words through, which must not be.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Sequence
from pathlib import Path

from dynasindy.viz.report.chart import chart
from dynasindy.viz.report.document import (
    Cell,
    Link,
    Listing,
    Part,
    Picture,
    Section,
    Table,
    Text,
    Verdict,
    anchor,
    joined,
)
from dynasindy.viz.report.vector import in_tags, svg

MARKS = {
    Verdict.AS.value: "as",
    Verdict.BETTER.value: "better",
    Verdict.SHORT.value: "short",
    Verdict.UNKNOWN.value: "unknown",
    "holds": "as",
    "in part": "part",
}
"""Class of a cell that is a verdict."""
WORDY = 40
"""Cells of more letters than this keep a width on a narrow screen at which they can be read; the table scrolls."""
FEW = 2
"""Columns that a phone shows side by side. Where there are more, a verdict would be out of sight: rows become cards."""
PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; \
script-src 'sha256-{digest}'; img-src data:">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{title}</title>
<style>
{style}</style>
<script>
{script}</script>
</head>
<body>
<header><label for="menu">Contents</label><b>{title}</b><button type="button" id="theme">dark / light</button></header>
<input type="checkbox" id="menu" aria-label="show the contents">
<nav aria-label="Contents"><ul>{links}</ul></nav>
<main>
<h1>{title}</h1>
{body}
</main>
</body>
</html>
"""


def write_html(title: str, sections: Sequence[Section], path: Path) -> Path:
    """Write a page as one HTML file."""
    here = Path(__file__).parent
    style, draw, use = ((here / name).read_text(encoding="utf-8") for name in ("page.css", "chart.js", "page.js"))
    script = f"{draw}{use}"
    links = "".join(f'<li><a href="#{s.anchor}">{html.escape(s.title)}</a></li>' for s in sections)
    body = []
    for section in sections:
        body.append(f'<section id="{section.anchor}"><h2>{html.escape(section.title)}</h2>')
        body += [_html(part) for part in joined(section.parts)]
        body.append("</section>")
    words = {"title": html.escape(title), "links": links, "body": "\n".join(body), "style": style, "script": script}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(PAGE.format(**words, digest=_digest(f"\n{script}")), encoding="utf-8")
    return path


def _digest(script: str) -> str:
    """Return what the page knows its own script by."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _html(part: Part) -> str:
    if isinstance(part, Table):
        head = "".join(f"<th>{_inline(cell)}</th>" for cell in part.header)
        judged = any(_verdict(cell) in MARKS for row in part.rows for cell in row)
        cards = judged and len(part.header) > FEW
        names = part.header if cards else [""] * len(part.header)
        rows = "".join("<tr>" + "".join(map(_cell, row, names)) + "</tr>" for row in part.rows)
        kind = ' class="cards"' if cards else ""
        return f'<div class="wide"><table{kind}><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>'
    if isinstance(part, Listing):
        return f"<pre>{html.escape(chr(10).join(part.lines))}</pre>"
    if isinstance(part, Picture):
        return _figure(part)
    return f"<p>{_inline(part.words if isinstance(part, Text) else part.ours)}</p>"


def _figure(part: Picture) -> str:
    numbers = chart(part.figure)
    data = "" if numbers is None else json.dumps(numbers, separators=(",", ":"), ensure_ascii=False)
    live = f'<script type="application/json">{data.replace("<", chr(92) + "u003c")}</script>' if data else ""
    source = f'<p class="source">{_inline(part.source)}</p>' if part.source else ""
    caption = f"<figcaption>{_inline(part.caption)}{source}</figcaption>"
    return f'<figure id="figure-{part.name}">{_themed(svg(part.figure, part.name))}{live}{caption}</figure>'


def _themed(element: str) -> str:
    """Let what is black, white or grid in a figure follow the colours of the page."""
    named = {"#000000": "currentColor", "#ffffff": "var(--page)", "#d9d9d9": "var(--line)"}
    return in_tags("|".join(named), lambda colour: named[colour[0]], element)


def _cell(cell: Cell, name: str) -> str:
    """Return a cell, which knows the name of its column where a narrow screen shows it beside the cell."""
    head = f' data-name="{html.escape(name.replace("`", ""))}"' if name else ""
    words = f'<a href="#{anchor(cell.title)}">{_inline(cell.words)}</a>' if isinstance(cell, Link) else _inline(cell)
    return f"<td{_mark(_verdict(cell))}{head}>{words}</td>"


def _verdict(cell: Cell) -> str:
    """Return the words of a cell, those of a link without its numbers."""
    return re.sub(r" \(.*", "", cell.words) if isinstance(cell, Link) else cell


def _mark(words: str) -> str:
    name = MARKS.get(words, "words" if len(words) > WORDY else "")
    return f' class="{name}"' if name else ""


def _inline(words: str) -> str:
    escaped = re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(words, quote=False))
    return re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", escaped)
