"""The whole report: its sections in order, a summary of what agrees, and its files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dynasindy.evaluation.given import understood
from dynasindy.viz.framework import framework
from dynasindy.viz.report import beyond, control, data, model
from dynasindy.viz.report.document import Picture, Section, Table, Text, write_html, write_markdown
from dynasindy.viz.report.sources import REPORT, Results

TITLE = "The paper's figures and tables, beside ours"
WORDS = (
    f"Made by `{REPORT}` from the results saved in the repository. The paper is Dyna-Style Reinforcement Learning "
    "Modeling and Control of Non-linear Dynamics. Each statement is something that one of its figures or tables shows, "
    "in our words; our numbers, and whether they agree, are computed from the files named below each figure. Our "
    "plants are `xi`, the paper's published model taken as a plant, and `tras`, the physics of its laboratory rig."
)


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
        found = sections(results)
    pages = [summary(found), *found]
    return [
        write_html(TITLE, pages, folder / "report.html"),
        *write_markdown(TITLE, pages, folder / "report.md", formats),
    ]


def summary(found: Sequence[Section]) -> Section:
    """Return how many statements of each section agree."""
    rows = []
    for section in found:
        verdicts = [finding.agrees for finding in section.findings]
        if verdicts or not section.title.startswith("Beyond"):
            counts = [str(verdicts.count(verdict)) for verdict in (True, False, None)]
            rows.append([section.title, *(counts if verdicts else ["-"] * 3)])
    header = ["of the paper", "statements that agree", "that do not", "not measured"]
    return Section("What agrees", [Text(WORDS), Table(header, rows)])


def _drawings() -> Section:
    words = (
        "Drawings without data: the framework, the control loop, the rig and its schematic. The framework and the loop "
        "as they are here are drawn below; Algorithm 1 stands line by line beside the code in `docs/algorithm.md`, and "
        "the rig moves in `docs/figures/tras_sine.gif`."
    )
    caption = (
        "What acts on the plant, what is learnt from it, and where experience goes. Drawn by `dynasindy.viz.framework`."
    )
    title = "Figures 1 to 4: framework, control loop, rig, schematic"
    return Section(title, [Text(words), Picture("framework", framework(), caption)])
