"""Pages say what the files of docs/results hold, and every result names the command and the commit that made it."""

import csv
import json
import re
from pathlib import Path

import pytest
import tables

from dynasindy.evaluation.ablation import Level, read_ablation, to_markdown

REPOSITORY = Path(__file__).parents[1]
RESULTS = REPOSITORY / "docs" / "results"
ORIGINS = sorted(RESULTS.rglob("origin.json"))


def test_the_command_leaves_no_difference():
    found = tables.pages()
    changed = [file.name for file, text in found.items() if file.read_text(encoding="utf-8") != text]
    assert not changed, "run: python scripts/tables.py"
    held = [block[2] for text in found.values() for block in tables.BLOCK.finditer(text)]
    assert sorted(held) == sorted(tables.TABLES)  # each once


def test_a_number_that_changed_in_a_page_is_written_anew(tmp_path, monkeypatch):
    page = tmp_path / "README.md"
    page.write_text("a\n\n<!-- table: main_job -->\n\n| old |\n\n<!-- end -->\n\nb\n")
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    main_job = tables.markdown("main_job")
    assert tables.pages()[page] == f"a\n\n<!-- table: main_job -->\n\n{main_job}\n\n<!-- end -->\n\nb\n"
    with (RESULTS / "gradient.csv").open(newline="") as file:
        found = [row for row in csv.DictReader(file) if (row["case"], row["plant"]) == ("step", "xi")]
    worst = max(float(row["pitch"]) for row in found if (row["scenario"], row["plant_seconds"]) == ("step", "10.0"))
    assert f" / {1000 * worst:.1f} |" in main_job.splitlines()[3]


def test_the_tables_of_the_ablation_are_made_of_its_rows():
    whole = (RESULTS / "ablation.md").read_text()
    assert whole == to_markdown(read_ablation(RESULTS / "ablation.csv"), Level())
    page = (RESULTS.parent / "ablation.md").read_text()
    shown = re.findall(r"^\| `(tras|xi)`, `(rollouts_\d+)` \| (.*) \|$", page, re.M)
    for plant, setting, cells in shown:
        (row,) = re.findall(rf"^\| {plant} \| dyna \| {setting} \| \S+ \| \S+ \| (.*)$", whole, re.M)
        assert row.replace(" [never, never]", "").startswith(cells)
    assert len(shown) == 6


@pytest.mark.parametrize("file", ORIGINS, ids=lambda file: file.parent.name)
def test_a_saved_run_names_its_command_and_a_commit_without_changes(file):
    origin = json.loads(file.read_text())
    assert origin["command"].startswith("python scripts/")
    assert re.fullmatch(r"[0-9a-f]{7,40}", origin["commit"])


@pytest.mark.parametrize("name", ["ablation.csv", "gradient.csv"])
def test_every_row_names_a_commit_without_changes(name):
    with (RESULTS / name).open(newline="") as file:
        commits = {row["commit"] for row in csv.DictReader(file)}
    assert commits and all(re.fullmatch(r"[0-9a-f]{7,40}", commit) for commit in commits)


def test_rows_of_the_ablation_are_those_of_the_saved_runs():
    compared = 0
    with (RESULTS / "ablation.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["seed"] == "0"]
    for row in rows:
        folder = RESULTS / "runs" / "_".join(row[key] for key in ("system", "experiment", "setting"))
        metrics = json.loads((folder / "metrics.json").read_text()) if folder.is_dir() else None
        if metrics is None or float(row["real_steps"]) > metrics["cost"]["real_steps"]:
            continue  # a longer run, whose policy is not saved
        ends = metrics["evaluation"]
        assert row["commit"] == json.loads((folder / "origin.json").read_text())["commit"]
        assert float(row["final_return"]) == pytest.approx(ends["return"], rel=1e-6)
        errors = [ends[f"steady_state_error/{axis}"] for axis in ("alpha_a", "alpha_p")]
        assert float(row["steady_state_error"]) == pytest.approx(max(errors), rel=1e-6)
        compared += 1
    assert compared >= 9
