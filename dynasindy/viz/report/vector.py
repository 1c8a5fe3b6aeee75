"""Figures as small files: vectors whose outlines are rounded and whose letters are text, pixels of few colours."""

from __future__ import annotations

import io
import re
import zlib
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from PIL import Image

from dynasindy.viz.style import STYLE, save

TEXT: dict[Any, Any] = {"svg.fonttype": "none", "path.simplify_threshold": 0.3}
"""Letters stay text, which is smaller than outlines and can be searched."""
TAG = re.compile(r"<style[^>]*>[^<]*</style>|<[^>]*>")
"""A tag, or rules of style with what they say."""
OFTEN = 4
"""A style that stands more often in a figure gets a name."""


def svg(figure: Figure, name: str) -> str:
    """Return a figure as a small SVG element.

    Args:
        figure: What to draw.
        name: Begins its ids, so that several share a page.
    """
    return in_tags(r'(\bid="|href="#|url\(#)', lambda found: f"{found[1]}{name}-", _svg(figure))


def in_tags(pattern: str, change: Callable[[re.Match[str]], str], element: str) -> str:
    """Return an SVG element with a pattern replaced in its tags and rules; what a label says stays as it is.

    Args:
        pattern: What to replace.
        change: What stands for a match.
        element: The element; in its labels `<` and `>` are escaped, as Matplotlib does, quotes are not.
    """
    return TAG.sub(lambda tag: re.sub(pattern, change, tag[0]), element)


def write_figure(figure: Figure, name: str, path: Path) -> Path:
    """Write a figure as a small file: outlines rounded, or pixels of 64 colours."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".svg":
        path.write_text(svg(figure, name) + "\n", encoding="utf-8")
    elif path.suffix == ".png":
        file = io.BytesIO()
        with matplotlib.rc_context(STYLE):
            figure.savefig(file, format="png", dpi=100)
        Image.open(file).convert("RGB").quantize(64, dither=Image.Dither.NONE).save(path, optimize=True)
    else:
        save(figure, path.with_suffix(""), [path.suffix[1:]])
    return path


@cache
def _svg(figure: Figure) -> str:
    """Draw a figure once for both pages, without what nobody sees."""
    file = io.StringIO()
    with matplotlib.rc_context({**STYLE, **TEXT}):
        figure.savefig(file, format="svg", metadata={"Date": None})
    element = file.getvalue()
    element = element[element.index("<svg") :]
    element = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", element, flags=re.S)
    element = element.replace('\n" ', '" ')
    element = re.sub(r'<g id="[^"]*"', "<g", element)  # nothing refers to a group
    element = in_tags(r' (?:d|x|y)="[^"]+"', lambda outline: _rounded(outline[0]), element)
    element = in_tags(r"'DejaVu Sans'(, sans-serif)?", lambda _: "sans-serif", element)
    return _named(re.sub(r"\s*\n\s*", "\n", element))


def _named(element: str) -> str:
    """Write a style that stands often only once; its name is that of its content, the same in every figure."""
    style = r' style="([^"]+)"'
    counts = Counter(one for tag in TAG.findall(element) for one in re.findall(style, tag))
    names = {one: f"s{zlib.crc32(one.encode()):x}" for one, count in counts.items() if count > OFTEN}
    rules = "".join(f".{name}{{{one}}}" for one, name in names.items())
    short = in_tags(style, lambda found: f' class="{names[found[1]]}"' if found[1] in names else found[0], element)
    return short.replace("</style>", f"{rules}</style>", 1)


def _rounded(outline: str) -> str:
    """Round the points of an outline to a tenth of a point, finer than a screen shows."""
    short = re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.1f}".removesuffix(".0"), outline)
    return re.sub(r"\s*([MLQCz])\s*", r"\1", short).replace(' "', '"')
