import shutil

import pytest

from dynasindy.evaluation.given import DamagedFileError
from dynasindy.viz.report import model
from dynasindy.viz.report.document import Finding, Text
from dynasindy.viz.report.sources import MissingResult, Results, each


def test_a_saved_run_says_where_it_comes_from(results):
    run = results.compared("xi", "dyna", "rollouts_800")
    assert run.source == ("Run `runs/xi_dyna_rollouts_800`, made by `python scripts/x.py` at commit abc1234.")
    assert run.setting("env.substeps") == 5 and run.setting("env.none.deeper") is None
    assert run.table("gate.csv")["episode"].tolist() == [1, 2, 3, 4, 5, 6]


def test_what_is_missing_has_a_line_with_its_command(results, empty):
    with pytest.raises(
        MissingResult, match=r"`xi_dyna_rollouts_0`; `python scripts/ablation\.py system=xi experiment=dyna"
    ):
        empty.compared("xi", "dyna", "rollouts_0")
    with pytest.raises(MissingResult, match=r"python scripts/train\.py system=tras folder=runs/tras_gradient`, then"):
        empty.trained("tras")
    with pytest.raises(MissingResult, match=r"baselines\.csv`; `python scripts/benchmark\.py baselines` makes it"):
        empty.rows("baselines.csv", "python scripts/benchmark.py baselines")
    with pytest.raises(MissingResult, match=r"has no `other\.csv`; `python scripts/ablation"):
        results.compared("xi", "dyna", "rollouts_0").table("other.csv")


def test_the_command_and_commit_of_a_table_are_those_of_the_list(results):
    assert results.source("speed.csv").endswith("`, made by `python scripts/y.py` at commit 1a2b3c4.")
    # A table whose rows name their commits says those.
    assert results.source("ablation.csv").endswith("`, made by `python scripts/y.py` at commit abc1234 and def5678.")
    assert "made by" not in results.source("other.csv")
    assert "made by" not in results.source("first_ablation.csv")


def test_a_missing_result_or_column_becomes_a_line_and_findings_come_first(results):
    def build(name):
        if name == "gone":
            raise MissingResult("Not measured: x; `make` makes it.")
        if name == "old":
            results.compared("xi", "dyna", "rollouts_0").table("gate.csv")["new_column"]
        return [Text("words"), Finding("xi", "a", "b")]

    finding, *lines = each(build, ("gone",), ("old",), ("good",))
    assert isinstance(finding, Finding)
    assert lines[0].words == "Not measured: x; `make` makes it."
    assert "saved results of old have no 'new_column'" in lines[1].words
    assert lines[2].words == "words"


@pytest.mark.parametrize(
    ("name", "section", "content"),
    [
        *(("gate.csv", model.learning_progress, text) for text in ("", "a,b\n1\n", "episode\nx\n", 'a\n"')),
        *(("model.json", model.coefficients, text) for text in ("", "{", "[]", "7", "\x00", "[" * 100_000)),
    ],
)
def test_a_damaged_file_of_a_saved_run_is_named_in_a_line(results, tmp_path, name, section, content):
    folder = shutil.copytree(results.folder, tmp_path / "results")
    for run in (folder / "runs").iterdir():
        (run / name).write_text(content)
    with pytest.raises(DamagedFileError, match=f"{name} is damaged") as error:
        section(Results(folder, results.settings))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("damage", [TypeError("x\ny"), ValueError("bad"), IndexError("none"), AttributeError("a")])
def test_what_a_section_stumbles_over_is_one_line_that_names_the_case(damage):
    def _of(plant, experiment):
        raise damage

    with pytest.raises(DamagedFileError, match="what is saved of xi dyna is damaged") as error:
        each(_of, ("xi", "dyna"))
    assert "\n" not in str(error.value)
