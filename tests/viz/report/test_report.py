"""The report of results written by hand, and that of docs/results."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from dynasindy.safe_io import DamagedFileError
from dynasindy.viz import report
from dynasindy.viz.report import HOLDS, SHORT, build, build_section

REPOSITORY = Path(__file__).parents[3]
RESULTS = REPOSITORY / "docs" / "results"
OF_FOUR = 3  # of four cases, xi and tras in two experiments, one is there


@pytest.fixture
def page(tmp_path, monkeypatch):
    """Build the page of some results, whose figures are not written."""
    monkeypatch.setattr(report, "save_figures", lambda figures, *_: [Path(f"{name}.svg") for name in figures])

    def _page(results):
        first, *figures = build(results, tmp_path / "report")
        return first.read_text(), {file.name for file in figures}

    return _page


def numbers(words: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?", words)]


def picture(section):
    (found,) = [part for _, part in section if hasattr(part, "figure")]
    return found


def texts(section):
    return [part for _, part in section if isinstance(part, str)]


def measured(section):
    return [part for _, part in section if hasattr(part, "verdict")]


def missing(section):
    return [part for part in texts(section) if part.startswith("Not measured")]


def test_the_committed_report_is_that_of_the_saved_results(page):
    text, figures = page(RESULTS)
    assert text == (REPOSITORY / "docs/report/report.md").read_text(), "run: python scripts/report.py"
    shown = set(re.findall(r"\]\(figures/([^)]+)\)", text))
    assert shown == figures == {one.name for one in (REPOSITORY / "docs/report/figures").iterdir()} and len(shown) > 30
    sources = text.partition("## Sources")[2].strip().split("\n\n")[1].splitlines()
    assert sources and all(re.search(r"made by `python scripts/[^`]+` at commit [0-9a-f]{7}", one) for one in sources)


def test_words_of_others_are_no_html_and_no_link(copied, page):
    hostile = "<script>alert(1)</script> [x](http://y) `a < b`"
    for file in copied.glob("runs/*/origin.json"):
        file.write_text(json.dumps({"command": hostile, "commit": hostile}))
    text, _ = page(copied)
    assert "alert(1)" in text and "<script" not in text and "[x](" not in text


def test_average_rewards_are_the_numbers_of_the_table(results):
    section = build_section(results, "average_rewards")
    (axis,) = picture(section).figure.axes
    curves = {line.get_label(): line.get_ydata() for line in axis.lines}
    np.testing.assert_allclose(curves["800 rollouts (3 seeds)"], [-10.0 / k + 1.0 for k in range(1, 7)])
    np.testing.assert_allclose(curves["no planning (3 seeds)"], [-200.0 / k + 1.0 for k in range(1, 7)])
    found = measured(section)
    assert numbers(found[1].ours) == [400, 6, 800, 4] and found[1].verdict is HOLDS
    assert "abc1234, def5678" in picture(section).caption
    assert len(missing(section)) == OF_FOUR and "xi, paper" in missing(section)[0]


def test_agents_without_a_model_and_runs_of_other_lengths(copied):
    folder = copied
    with (folder / "ablation.csv").open("a") as file:
        file.write("xi,dyna,sb3_sac_5,0,7,5,abc1234\r\nxi,dyna,sb3_sac_5,1,7,5,abc1234\r\n")
        file.write("xi,dyna,rollouts_800,3,9,4,abc1234\r\n")
    with (folder / "ablation_curves.csv").open("a") as file:
        for name in ("rollouts_0", "rollouts_400", "rollouts_800"):
            for seed, end in ((0, 9), (1, 7 if name == "rollouts_0" else 9), (2, 9)):
                file.writelines(f"xi,dyna,{name},{seed},{k},-1,0.01,0.01\r\n" for k in range(7, end + 1))
    section = build_section(copied, "average_rewards")
    level = measured(section)[1]
    assert numbers(level.ours)[-2:] == [7, 5] and level.verdict is SHORT
    # Nothing is compared after episode 7, which is as far as all seeds go.
    assert {len(line.get_xdata()) for line in picture(section).figure.axes[0].lines} - {0} == {7}


def test_the_error_of_the_model_over_episodes(results):
    section = build_section(results, "model_learning")
    whole, judged, *_ = picture(section).figure.axes[0].lines
    np.testing.assert_allclose(whole.get_ydata(), [5.0 * 0.1**k for k in range(1, 7)])
    np.testing.assert_allclose(judged.get_ydata(), [0.1**k for k in range(1, 7)])
    (finding,) = measured(section)
    assert finding.verdict is HOLDS and "from episode 2" in finding.ours


def test_states_and_coefficients_are_judged_by_their_numbers(results):
    before, after = (build_section(results, f"states_{when}") for when in ("before", "after"))
    assert [finding.verdict for finding in measured(before)] == [HOLDS]
    # The states of the excitation are sines, which no such model gives under its inputs.
    assert [finding.verdict for finding in measured(after)] == [HOLDS, SHORT]
    section = build_section(results, "coefficients")
    assert [finding.verdict for finding in measured(section)] == [HOLDS]
    (table,) = [text for text in texts(section) if text.startswith("| ")]
    header, _, *rows = ([cell.strip() for cell in line.strip("| ").split(" | ")] for line in table.splitlines())
    cells = {(row[0], name): cell for row in rows for name, cell in zip(header[1:], row[1:])}
    assert cells["`Omega_a`", "d `Omega_a`/dt"] == "-10.057 (-10.057)"
    assert cells["`u_p`", "d `omega_p`/dt"] == "6100 (6100)"


def test_steps_and_waves_are_those_of_the_runs(results):
    section = build_section(results, "step")
    first, second, *_ = measured(section)
    assert numbers(first.ours) == [0.2, 400, 0.05, 800, 0.01]
    assert first.verdict is second.verdict is HOLDS
    for shape in ("sine", "square"):
        (axis, _) = picture(build_section(results, shape)).figure.axes
        lines = {line.get_label(): line.get_ydata() for line in axis.lines}
        np.testing.assert_allclose(lines["800 rollouts"] - lines["reference"], 0.01, atol=1e-12)
        np.testing.assert_allclose(lines["no planning"] - lines["reference"], 0.2, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "section", "content"),
    [
        *(("gate.csv", "model_learning", text) for text in ("", "a,b\n1\n", "episode\nx\n", 'a\n"')),
        *(("model.json", "coefficients", text) for text in ("", "{", "[]", "7", "\x00", "[" * 100_000)),
        *(("config.yaml", "training_data", text) for text in ("a: [1, 2", "\x00", "\tenv: 1")),
    ],
)
def test_a_damaged_file_of_a_saved_run_is_named(copied, name, section, content):
    for run in (copied / "runs").iterdir():
        (run / name).write_text(content)
    with pytest.raises(DamagedFileError, match=name):
        build_section(copied, section)
