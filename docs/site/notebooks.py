"""Notebooks as pages of the site: their cells, and below each cell what it prints and draws where the cells are run."""

import base64
import contextlib
import html
import io
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

WANTED = "NOTEBOOKS"
"""Variable of the environment that has the cells run: they take about a minute, too long for every change of a word."""


def page_of(notebook: Path, run: bool) -> str:
    """Return a notebook as a page, and where to get it.

    Args:
        notebook: An `.ipynb` file without outputs.
        run: Whether its cells are run, in a folder of their own, and what they print and draw stands below them.

    Raises:
        Exception: What a cell raises, where the cells are run.
    """
    cells = json.loads(notebook.read_text())["cells"]
    outputs = _run([_text(cell) for cell in cells if cell["cell_type"] == "code"]) if run else iter(())
    parts = []
    for cell in cells:
        if cell["cell_type"] == "markdown":
            parts.append(_text(cell))
        elif _text(cell):
            parts += [f"```python\n{_text(cell)}\n```", next(outputs, "")]
    download = f'<a href="../{notebook.name}" download>Download this notebook</a>'
    return "\n\n".join(part for part in (*parts, download) if part) + "\n"


def wanted() -> bool:
    """Return whether the cells are to be run, as the environment says."""
    return bool(os.environ.get(WANTED))


def _text(cell: dict[str, Any]) -> str:
    return "".join(cell["source"])


def _run(cells: list[str]) -> Iterator[str]:
    """Yield what each cell prints and draws, as Markdown."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    room: dict[str, Any] = {"__name__": "__main__"}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for cell in cells:
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(compile(cell, "<cell>", "exec"), room)
            words = html.escape(printed.getvalue().rstrip())
            shown = [f"<pre><code>{words}</code></pre>"] if words else []
            for number in pyplot.get_fignums():
                drawn = io.BytesIO()
                pyplot.figure(number).savefig(drawn, format="png", dpi=120)
                data = base64.b64encode(drawn.getvalue()).decode()
                shown.append(f'<img alt="what the cell draws" src="data:image/png;base64,{data}">')
            pyplot.close("all")
            yield "\n\n".join(shown)
