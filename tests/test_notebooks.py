"""The notebooks in docs/ hold no outputs, and run from their first cell to their last."""

import ast
import json
import os
import shutil
import sys
from pathlib import Path

import forked
import pytest

REPOSITORY = Path(__file__).parents[1]
NOTEBOOKS = sorted((REPOSITORY / "docs" / "notebooks").glob("*.ipynb"))
NAMES = [notebook.stem for notebook in NOTEBOOKS]


def code(notebook: Path) -> str:
    """Return the code of a notebook as one program."""
    cells = json.loads(notebook.read_text())["cells"]
    return "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")


def test_there_are_two_notebooks():
    assert NAMES == ["log_to_c", "ten_seconds"]


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=NAMES)
def test_a_notebook_is_small_and_holds_no_outputs_nor_commands_of_jupyter(notebook):
    record = json.loads(notebook.read_text())
    assert notebook.stat().st_size < 10_000
    assert (record["nbformat"], len({cell["id"] for cell in record["cells"]})) == (4, len(record["cells"]))
    for cell in record["cells"]:
        assert cell["cell_type"] == "markdown" or (cell["outputs"], cell["execution_count"]) == ([], None)
        assert max(len(line) for line in cell["source"]) <= 121  # with its end
    ast.parse(code(notebook))


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=NAMES)
def test_a_notebook_runs_and_its_controller_holds_the_plant(notebook, tmp_path):
    if notebook.stem == "log_to_c" and not any(shutil.which(name) for name in ("cc", "gcc", "clang")):
        pytest.skip("there is no C compiler")
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    done = forked.run([sys.executable, "-c", code(notebook)], cwd=tmp_path, env=environment, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("mean error of the last 5 s")]
    assert all(float(word) < 0.002 for word in line.split() if word.startswith("0."))
