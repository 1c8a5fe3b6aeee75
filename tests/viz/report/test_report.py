"""The report of results written by hand, and that of docs/results."""

import csv
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from dynasindy.safe_io import DamagedFileError
from dynasindy.viz.report import TITLE, Results, beyond, build, pages, sections
from dynasindy.viz.report.document import Picture, Section, Table, Text, Verdict, render_html, render_markdown
from dynasindy.viz.response import tracking

REPOSITORY = Path(__file__).parents[3]
RESULTS = REPOSITORY / "docs" / "results"
OF_FOUR = 3  # of four cases, xi and tras in two experiments, one is there


@pytest.fixture(scope="module")
def saved() -> list[Section]:
    files = RESULTS.glob("runs/*/config.yaml")
    return pages(Results(RESULTS, {one.parent.name: OmegaConf.to_container(OmegaConf.load(one)) for one in files}))


def picture(section):
    (found,) = [part for part in section.parts if isinstance(part, Picture)]
    return found


def tables(section):
    return [part for part in section.parts if isinstance(part, Table)]


def measured(section):
    return [finding for finding in section.findings if finding.verdict is not Verdict.UNKNOWN]


def missing(section):
    return [part.words for part in section.parts if isinstance(part, Text) and part.words.startswith("Not measured")]


def test_the_committed_report_is_that_of_the_saved_results(saved):
    shown = (REPOSITORY / "docs/report/report.md").read_text()
    assert render_markdown(TITLE, saved, "svg", "report.html") == shown, "run: python scripts/report.py"
    figures = set(re.findall(r"\]\(figures/([^)]+)\)", shown))
    assert figures == {one.name for one in (REPOSITORY / "docs/report/figures").iterdir()} and len(figures) > 40
    assert (REPOSITORY / "docs/report/report.html").read_text().count("<svg ") == len(figures)


def test_every_picture_and_run_of_the_report_has_its_command_and_commit(saved):
    for section in saved:
        for part in section.parts:
            if isinstance(part, Picture) and part.name != "framework":
                assert re.search(r"made by `python scripts/[^`]+` at commit [0-9a-f]{7}", part.source), part.name


def test_the_identification_table_is_the_csv_cell_by_cell(saved):
    (table,) = tables(next(section for section in saved if section.title.endswith("identification")))
    with (RESULTS / "identification.csv").open(newline="") as file:
        assert [list(table.header), *map(list, table.rows)] == list(csv.reader(file))


class Page(HTMLParser):
    """Checks that tags of a page are closed in their order, and collects its ids and what it refers to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open, self.ids, self.targets = [], [], []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "br", "hr", "img", "input"):
            self.open.append(tag)
        self.ids += [value for name, value in attributes if name == "id"]
        self.targets += [value for name, value in attributes if name in ("href", "src", "xlink:href")]

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_the_html_is_well_formed_and_refers_to_nothing_outside_itself():
    page = Page(text := (REPOSITORY / "docs/report/report.html").read_text())
    assert page.targets and {target.removeprefix("#") for target in page.targets} <= set(page.ids)
    assert len(page.ids) == len(set(page.ids)) and not re.search(r"https?://(?!www\.w3\.org)", text)


def test_words_of_others_are_no_html_and_no_link():
    hostile = "<script>alert(1)</script> [x](http://y) `a < b`"
    figure = tracking([0.0, 0.1], [[0.1, 0.2]] * 2, {"<script>": [[0.0, 0.1]] * 2})
    parts = [Text(hostile), Table([hostile], [[hostile]]), Picture("p", figure, hostile, hostile)]
    html = render_html(hostile, [Section(hostile, parts)])
    assert "<script" not in html and "<code>a &lt; b</code>" in html
    markdown = render_markdown("t", [Section("s", parts)])
    assert "<script" not in markdown and "[x](" not in markdown


def test_average_rewards_are_the_numbers_of_the_table(results):
    section = sections.rewards(results)
    (axis,) = picture(section).figure.axes
    curves = {line.get_label(): line.get_ydata() for line in axis.lines}
    np.testing.assert_allclose(curves["800 rollouts (3 seeds)"], [-10.0 / k + 1.0 for k in range(1, 7)])
    np.testing.assert_allclose(curves["no planning (3 seeds)"], [-200.0 / k + 1.0 for k in range(1, 7)])
    found = measured(section)
    assert "no planning never, 400 rollouts 6, 800 rollouts 4" in found[2].ours and found[2].verdict is Verdict.AS
    assert "no planning 0.2 to 0.2, 400 rollouts 0.05 to 0.0501, 800 rollouts 0.01 to 0.01" in found[4].ours
    assert "commit abc1234 and def5678" in picture(section).source
    assert len(missing(section)) == OF_FOUR and "python scripts/ablation.py system=xi" in missing(section)[0]


def test_agents_without_a_model_and_runs_of_other_lengths(results, tmp_path):
    folder = shutil.copytree(results.folder, tmp_path / "results")
    with (folder / "ablation.csv").open("a") as file:
        file.write("xi,dyna,sb3_sac_5,0,7,5,abc1234\r\nxi,dyna,sb3_sac_5,1,7,5,abc1234\r\n")
        file.write("xi,dyna,rollouts_800,3,9,4,abc1234\r\n")
    with (folder / "ablation_curves.csv").open("a") as file:
        for name in ("rollouts_0", "rollouts_400", "rollouts_800"):
            for seed, end in ((0, 9), (1, 7 if name == "rollouts_0" else 9), (2, 9)):
                file.writelines(f"xi,dyna,{name},{seed},{k},-1,0.01,0.01\r\n" for k in range(7, end + 1))
    more = Results(folder, results.settings)
    section = sections.rewards(more)
    level = measured(section)[2]
    assert level.ours.endswith("(7 episodes) 5") and level.verdict is Verdict.SHORT
    # Nothing is compared after episode 7, which is as far as all seeds go.
    assert {len(line.get_xdata()) for line in picture(section).figure.axes[0].lines} - {0} == {7}
    assert (
        "after 6 real episodes. Figure 11 is of other runs, of 6 and 9 episodes"
        in picture(sections.steps(more)).caption
    )


def test_the_whole_curve_of_longer_runs(results, tmp_path):
    folder = shutil.copytree(results.folder, tmp_path / "results")
    for name in ("ablation.csv", "ablation_curves.csv"):
        file = folder / name
        file.write_text(file.read_text().replace("xi,dyna", "xi,paper"))
    header = "system,setting,seed,episode,evaluated_return,azimuth,pitch,commit\n"
    rows = [f"xi,rollouts_800,0,{k},{-600 / k},{1 / k},{2 / k},abc1234\n" for k in (5, 10, 20, 40)]
    (folder / "paper_in_full.csv").write_text(header + "".join(rows))
    (table,) = tables(sections.rewards(Results(folder, results.settings)))
    # Returns -120, -60, -30 and -15; worse axis .4, .2, .1 and .05 rad, the level; curves end at episode 6.
    assert list(table.rows[0]) == ["800 rollouts", "1", "40", "-56.25", "-15", "0.4", "0.05", "1 of 1", "40"]


def test_the_error_of_the_model_over_episodes(results, tmp_path):
    folder = shutil.copytree(results.folder, tmp_path / "results")
    whole, judged, *levels = picture(sections.learning_progress(results)).figure.axes[0].lines
    np.testing.assert_allclose(whole.get_ydata(), [5.0 * 0.1**k for k in range(1, 7)])
    np.testing.assert_allclose(judged.get_ydata(), [0.1**k for k in range(1, 7)])
    assert [line.get_ydata()[0] for line in levels] == [0.2, 0.5]
    (finding,) = measured(sections.learning_progress(results))
    assert finding.verdict is Verdict.AS and "from episode 2" in finding.ours
    gate = folder / "runs" / "xi_dyna_rollouts_800" / "gate.csv"
    gate.write_text(re.sub(r"(?m)^2,[^,]+", "2,inf", gate.read_text()))
    (axis,) = picture(sections.learning_progress(Results(folder, results.settings))).figure.axes
    assert [line.get_xdata().tolist() for line in axis.lines if line.get_marker() == "^"] == [[2.0]]


def test_states_and_coefficients_are_judged_by_their_numbers(results):
    before, after = (sections.states(results, when) for when in ("first", "last"))
    assert [finding.verdict for finding in measured(before)] == [Verdict.AS, Verdict.AS]
    assert "`alpha_a` 50" in measured(before)[1].ours  # an offset of 0.1 on a sine of amplitude 0.1
    # The states of the excitation are sines, which no such model gives under its inputs.
    assert [finding.verdict for finding in measured(after)] == [Verdict.AS, Verdict.SHORT]
    section = sections.coefficients(results)
    assert [finding.verdict for finding in measured(section)] == [Verdict.AS]
    (table,) = tables(section)
    cells = {(row[0], name): cell for row in table.rows for name, cell in zip(table.header[1:], row[1:])}
    assert cells["`Omega_a`", "d `Omega_a`/dt"] == "-10.057 (-10.057)"
    assert cells["`u_p`", "d `omega_p`/dt"] == "6100 (6100)"


def test_steps_and_waves_are_those_of_the_runs(results):
    section = sections.steps(results)
    (table,) = tables(section)
    assert [list(row[1:]) for row in table.rows] == [
        ["0.2", "0.2", "5", "-"],
        ["0.05", "0.05", "5", "-"],
        ["0.01", "0.01", "5", "-"],
    ]
    assert [finding.verdict for finding in section.findings[:3]] == [Verdict.AS, Verdict.BETTER, Verdict.AS]
    for shape in ("sine", "square"):
        lines = {
            line.get_label(): line.get_ydata() for line in picture(sections.wave(results, shape)).figure.axes[0].lines
        }
        np.testing.assert_allclose(lines["800 rollouts"] - lines["reference"], 0.01, atol=1e-12)
        np.testing.assert_allclose(lines["no planning"] - lines["reference"], 0.2, atol=1e-12)


def test_hyperparameters_are_those_of_the_saved_runs(saved):
    section = next(section for section in saved if section.title.startswith("Table 1"))
    (table,) = tables(section)
    paper = OmegaConf.load(RESULTS / "runs/xi_paper_rollouts_800/config.yaml")
    assert [float(row[4]) for row in table.rows] == [
        float(OmegaConf.select(paper, row[3].strip("`"))) for row in table.rows
    ]
    assert section.findings[0].verdict is Verdict.AS


def row(model, value, metric="test simulated, RMSE"):
    return {"rig": "tanks", "model": model, "metric": metric, "value": value, "unit": "V", "commit": "abc1234"}


def test_bars_are_as_long_as_the_newest_errors_and_lines_stand_where_others_are(tmp_path):
    rows = [row("ours", "0.3"), row("ours, earlier", "0.1"), row("ours", "0.1", "train"), row("ours", "0.2")]
    rows += [row("pysindy", "2.5"), row("linear", "inf")]
    with (tmp_path / "rigs.csv").open("w", newline="") as file:
        csv.DictWriter(file, rows[0]).writerows([dict(zip(rows[0], rows[0])), *rows])
    (axis,) = picture(beyond.real_logs(Results(tmp_path))).figure.axes
    names = [label.get_text() for label in axis.get_yticklabels()]
    widths = dict(zip(names, (bar.get_width() for bar in axis.patches), strict=True))
    assert widths == {"linear": axis.get_xlim()[0], "PySINDy": 2.5, "ours": 0.2}
    assert [tuple(line.get_xdata()) for line in axis.lines] == [(0.191, 0.191), (0.396, 0.396)]


def test_margins_are_the_least_over_seeds(tmp_path):
    (tmp_path / "margins.csv").write_text(
        "plant,planning,gain,phase_deg,delay_s,disk,draws,unstable_draws,commit\n"
        "tras,nominal,2.5,18.0,0.03,0.3,20,7,a\ntras,nominal,3.5,15.0,0.02,0.4,20,1,a\n"
    )
    (table,) = tables(beyond.margins(Results(tmp_path)))
    assert [list(row) for row in table.rows] == [["tras", "nominal", "2", "2.5", "15", "0.02", "0.3", "8 of 40"]]


def test_controllers_are_interquartile_means_over_seeds(tmp_path):
    lines = [f"xi,LQI,identified,{k},10.0,step,rmse,{a},0.2,{1 + k}\n" for k, a in enumerate((1, 2, 4, 99))]
    header = "plant,controller,model,seed,real_seconds,scenario,metric,azimuth,pitch,ms_per_action\n"
    (tmp_path / "baselines.csv").write_text(header + "".join(lines))
    (table,) = tables(beyond.baselines(Results(tmp_path)))
    assert [list(row) for row in table.rows] == [["LQI", "identified", "10.0", "4", "3 / 0.2", "2.5"]]


def test_without_any_result_every_section_stands_and_says_what_makes_it(saved, tmp_path):
    html, markdown, *figures = build(Results(tmp_path), tmp_path / "report")
    assert {figure.stem for figure in figures} == {"framework"} and html.is_file()
    titles = [line for line in markdown.read_text().splitlines() if line.startswith("## ")]
    assert titles == [f"## {section.title}" for section in saved]
    empty = pages(Results(tmp_path))
    for section in empty[4:]:
        assert missing(section) and all("`python scripts/" in words for words in missing(section)), section.title
    everything, nothing = (
        {(finding.case, finding.statement) for section in page for finding in section.findings}
        for page in (saved, empty)
    )
    assert everything == nothing and len(nothing) > 100


@pytest.mark.parametrize("formats", [[], ["pdf", "svg"]])
def test_formats_that_no_page_shows_are_refused(tmp_path, formats):
    with pytest.raises(ValueError, match="formats"):
        build(Results(tmp_path), tmp_path / "report", formats)
    assert not (tmp_path / "report").exists()


@pytest.mark.parametrize(
    ("name", "section", "content"),
    [
        *(("gate.csv", sections.learning_progress, text) for text in ("", "a,b\n1\n", "episode\nx\n", 'a\n"')),
        *(("model.json", sections.coefficients, text) for text in ("", "{", "[]", "7", "\x00", "[" * 100_000)),
    ],
)
def test_a_damaged_file_of_a_saved_run_is_named(results, tmp_path, name, section, content):
    folder = shutil.copytree(results.folder, tmp_path / "results")
    for run in (folder / "runs").iterdir():
        (run / name).write_text(content)
    with pytest.raises(DamagedFileError, match=name):
        section(Results(folder, results.settings))
