"""Notebooks with their outputs: `python docs/site/notebooks.py` runs them and writes down what each cell shows.

On the site a notebook is a page of its cells, and below each cell of what it shows.
"""

import ast
import base64
import contextlib
import html
import io
import json
import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
ESCAPES = re.compile(r"\x1b\[[0-9;]*m")
Output = dict[str, Any]


def page_of(notebook: Path) -> str:
    """Return a notebook as a page, and where to get it."""
    parts = []
    for cell in json.loads(notebook.read_text())["cells"]:
        if cell["cell_type"] == "markdown":
            parts.append(_text(cell["source"]))
        elif _text(cell["source"]):
            parts.append(f"```python\n{_text(cell['source'])}\n```")
            parts += [_shown(output) for output in cell["outputs"]]
    download = f'<a href="../{notebook.name}" download>Download this notebook</a>'
    return "\n\n".join((*parts, download)) + "\n"


def outputs_of(notebook: Path) -> list[list[Output]]:
    """Run the cells of a notebook, in a folder of their own, and return the outputs of each cell of code.

    As in Jupyter these are what a cell prints and the value of its last line, with its picture if it has one.

    Raises:
        Exception: What a cell raises.
    """
    cells = [cell for cell in json.loads(notebook.read_text())["cells"] if cell["cell_type"] == "code"]
    room: dict[str, Any] = {"__name__": "__main__"}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        return [_outputs(_text(cell["source"]), room) for cell in cells]


def write(notebook: Path) -> None:
    """Run a notebook and write its outputs into it."""
    record, outputs = json.loads(notebook.read_text()), outputs_of(notebook)
    cells = [cell for cell in record["cells"] if cell["cell_type"] == "code"]
    for count, (cell, shown) in enumerate(zip(cells, outputs, strict=True), start=1):
        for output in shown:
            if output["output_type"] == "execute_result":
                output["execution_count"] = count
        cell |= {"execution_count": count, "outputs": shown}
    notebook.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n")


def _outputs(source: str, room: dict[str, Any]) -> list[Output]:
    tree, printed, value = ast.parse(source), io.StringIO(), None
    last = ast.Expression(tree.body.pop().value) if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "<cell>", "exec"), room)
        if last is not None:
            value = eval(compile(last, "<cell>", "eval"), room)
    outputs: list[Output] = []
    if words := ESCAPES.sub("", printed.getvalue()):
        outputs.append({"output_type": "stream", "name": "stdout", "text": words.splitlines(keepends=True)})
    if value is not None:
        data: dict[str, Any] = {"text/plain": repr(value).splitlines(keepends=True)}
        if hasattr(value, "_repr_png_"):
            data["image/png"] = base64.b64encode(value._repr_png_()).decode()
        outputs.append({"output_type": "execute_result", "data": data, "metadata": {}, "execution_count": None})
    return outputs


def _shown(output: Output) -> str:
    """Return an output as Markdown: its picture, or else its words."""
    data = output.get("data", {})
    if "image/png" in data:
        words = html.escape(_text(data["text/plain"]), quote=True)
        return f'<img alt="{words}" src="data:image/png;base64,{data["image/png"]}">'
    words = _text(output["text"] if output["output_type"] == "stream" else data["text/plain"])
    return f"<pre><code>{html.escape(words.rstrip())}</code></pre>"


def _text(lines: list[str]) -> str:
    return "".join(lines)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for file in map(Path, sys.argv[1:]) if sys.argv[1:] else sorted(FOLDER.glob("*.ipynb")):
        write(file)
