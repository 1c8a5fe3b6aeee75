"""The whole report: its sections in order, a summary of what agrees, and its files."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from dynasindy.evaluation.given import understood
from dynasindy.viz.framework import framework
from dynasindy.viz.report import beyond, control, data, engineering, model
from dynasindy.viz.report.document import Picture, Section, Text, write_markdown
from dynasindy.viz.report.overview import overview
from dynasindy.viz.report.page import write_html
from dynasindy.viz.report.sources import CASES, MissingResult, Results, listed, told

TITLE = "The paper's figures and tables, beside ours"


def sections(results: Results) -> list[Section]:
    """Return the sections of the paper, in its order, and those beyond it."""
    return [
        _drawings(),
        data.chirp_input(results),
        data.training(results),
        model.hyperparameters(results),
        model.learning_progress(results),
        model.states(results, "first"),
        model.states(results, "last"),
        model.coefficients(results),
        control.rewards(results),
        control.steps(results),
        control.wave(results, "sine"),
        control.wave(results, "square"),
        beyond.gradient(results),
        beyond.baselines(results),
        beyond.trust(results),
        beyond.identification(results),
        engineering.real_logs(results),
        engineering.margins(results),
        beyond.speed(results),
    ]


def build(results: Results, folder: Path, formats: Sequence[str] = ("svg", "png")) -> list[Path]:
    """Write `report.html`, which needs no other file, and `report.md` with `figures/`.

    Args:
        results: Saved runs and tables.
        folder: Where; made if missing.
        formats: File formats of the figures of the Markdown page, the one it shows first.

    Returns:
        The files.

    Raises:
        ValueError: There is no format, or the first one cannot be shown by a Markdown page.
        DamagedFileError: A saved file is not what a section expects.
    """
    if not formats or formats[0] not in ("svg", "png") or not all(suffix.isalnum() for suffix in formats):
        raise ValueError(f"formats is {list(formats)}; a page shows svg or png, name one of them first")
    with understood(results.folder):
        found = pages(results)
    page = write_html(TITLE, found, folder / "report.html")
    return [page, *write_markdown(TITLE, found, folder / "report.md", formats, page.name)]


def pages(results: Results) -> list[Section]:
    """Return the verdict and all sections, the page from top to bottom."""
    found = sections(results)
    return [*overview(found, _lengths(results)), *found]


def _lengths(results: Results) -> dict[str, str]:
    """Say after how many real episodes the runs ended, by their cases: those of figure 11, and the saved ones."""
    found = {}
    for plant, experiment in CASES:
        with suppress(MissingResult):
            saved = int(results.compared(plant, experiment, "rollouts_800").setting("train.episodes") or 0)
            curves = results.lengths(plant, experiment) or {saved}
            longer = f"{listed(map(str, sorted(curves)))} episodes in figure 11, {saved} elsewhere"
            found[told(plant, experiment)] = f"{saved} episodes" if curves == {saved} else longer
    return found


def _drawings() -> Section:
    words = (
        "Drawings without data: the framework, the control loop, the rig and its schematic. The framework and the loop "
        "as they are here are drawn below; Algorithm 1 stands line by line beside the code in `docs/algorithm.md`, and "
        "the rig moves in `docs/figures/tras_sine.gif`."
    )
    caption = "What acts on the plant, what is learnt from it, and where experience goes."
    title = "Figures 1 to 4: framework, control loop, rig, schematic"
    return Section(
        title,
        [Text(words), Picture("framework", framework(), caption, "Drawn by `dynasindy.viz.framework`, of no run.")],
    )
