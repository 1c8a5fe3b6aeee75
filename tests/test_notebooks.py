"""The notebooks in docs/ hold their outputs, which are those of their cells, run from the first to the last."""

import ast
import json
import os
import re
import shutil
import sys
from pathlib import Path

import forked
import pytest

REPOSITORY = Path(__file__).parents[1]
NOTEBOOKS = sorted((REPOSITORY / "docs" / "notebooks").glob("*.ipynb"))
NAMES = [notebook.stem for notebook in NOTEBOOKS]


def cells(notebook: Path) -> list[dict]:
    """Return the cells of code of a notebook."""
    return [cell for cell in json.loads(notebook.read_text())["cells"] if cell["cell_type"] == "code"]


def shown(notebook: Path) -> list[tuple[set[str], list[str]]]:
    """Return the names in each output of a notebook, without numbers, and its kinds: text or picture."""
    found = []
    for cell in cells(notebook):
        for output in cell["outputs"]:
            data = output.get("data", {})
            text = "".join(output.get("text") or data["text/plain"])
            found.append((set(re.findall(r"[^\W\d]\w+", text)), [*data]))
    return found


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=NAMES)
def test_a_notebook_is_small_and_holds_its_outputs_and_no_commands_of_jupyter(notebook):
    record = json.loads(notebook.read_text())
    assert notebook.stat().st_size < 100_000
    assert (record["nbformat"], len({cell["id"] for cell in record["cells"]})) == (4, len(record["cells"]))
    assert max(len(line) for cell in record["cells"] for line in cell["source"]) <= 121  # with its end
    ast.parse("\n\n".join("".join(cell["source"]) for cell in cells(notebook)))
    assert [cell["execution_count"] for cell in cells(notebook)] == [*range(1, len(cells(notebook)) + 1)]
    kinds = [kind for _, kinds in shown(notebook) for kind in kinds]
    assert "image/png" in kinds and not re.search(r"/tmp|/home|/work|\bat 0x", notebook.read_text())


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=NAMES)
def test_a_notebook_shows_what_it_holds_when_it_is_run(notebook, tmp_path):
    if notebook.stem == "log_to_c" and not any(shutil.which(name) for name in ("cc", "gcc", "clang")):
        pytest.skip("there is no C compiler")
    copy = Path(shutil.copy(notebook, tmp_path))
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    command = [sys.executable, str(REPOSITORY / "docs" / "site" / "notebooks.py"), str(copy)]
    done = forked.run(command, cwd=tmp_path, env=environment, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    assert shown(copy) == shown(notebook) and sorted(tmp_path.iterdir()) == [copy]
