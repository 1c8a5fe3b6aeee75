"""Figures as small files: vectors whose outlines are rounded and whose letters are text, pixels of few colours."""

from __future__ import annotations

import io
import re
import zlib
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from PIL import Image

from dynasindy.viz.style import STYLE, save

TEXT: dict[Any, Any] = {"svg.fonttype": "none", "path.simplify_threshold": 0.3}
"""Letters stay text, which is smaller than outlines and can be searched."""
OFTEN = 4
"""A style that stands more often in a figure gets a name."""


def svg(figure: Figure, name: str) -> str:
    """Return a figure as a small SVG element.

    Args:
        figure: What to draw.
        name: Begins its ids, so that several share a page.
    """
    return re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{name}-", _svg(figure))


def write_figure(figure: Figure, name: str, path: Path) -> Path:
    """Write a figure as a small file: outlines rounded, or pixels of 64 colours."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".svg":
        path.write_text(svg(figure, name) + "\n")
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
    element = re.sub(r' d="[^"]+"', lambda outline: _rounded(outline[0]), element)
    element = re.sub(r' [xy]="[^"]+"', lambda place: _rounded(place[0]), element)
    element = re.sub(r"'DejaVu Sans'(, sans-serif)?", "sans-serif", element)
    return _named(re.sub(r"\s*\n\s*", "\n", element))


def _named(element: str) -> str:
    """Write a style that stands often only once; its name is that of its content, the same in every figure."""
    counts = Counter(re.findall(r' style="([^"]+)"', element))
    names = {style: f"s{zlib.crc32(style.encode()):x}" for style, count in counts.items() if count > OFTEN}
    rules = "".join(f".{name}{{{style}}}" for style, name in names.items())
    short = re.sub(
        r' style="([^"]+)"', lambda found: f' class="{names[found[1]]}"' if found[1] in names else found[0], element
    )
    return short.replace("</style>", f"{rules}</style>", 1)


def _rounded(outline: str) -> str:
    """Round the points of an outline to a tenth of a point, finer than a screen shows."""
    short = re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.1f}".removesuffix(".0"), outline)
    return re.sub(r"\s*([MLQCz])\s*", r"\1", short).replace(' "', '"')
