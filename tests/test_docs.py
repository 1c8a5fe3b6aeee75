"""The pages in docs/ say what the code says: links, names, config values and departures from the paper."""

import re
import shlex
from pathlib import Path

import pytest
import yaml
from configs import composed
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

import dynasindy

REPOSITORY = Path(__file__).parents[1]
README = REPOSITORY / "README.md"
ROOT = [README, REPOSITORY / "CHANGELOG.md", REPOSITORY / "CONTRIBUTING.md"]
PAGES = [*sorted((REPOSITORY / "docs").glob("*.md")), *ROOT]
RESULTS = sorted((REPOSITORY / "docs" / "results").glob("*.md"))
ALGORITHM = REPOSITORY / "docs" / "algorithm.md"
SOURCES = sorted(
    path
    for folder, suffix in (("dynasindy", "py"), ("scripts", "py"), ("conf", "yaml"))
    for path in (REPOSITORY / folder).rglob(f"*.{suffix}")
)


def departures(text: str) -> list[str]:
    """Every `Departure:` of a source text, to the end of its sentence or paragraph, on one line."""
    found = []
    lines = [re.sub(r'^\s*#?:?\s?|"""\s*$', "", line).strip() for line in text.splitlines()]
    for number, line in enumerate(lines):
        if "Departure:" not in line:
            continue
        words = [line.partition("Departure:")[2]]
        for following in lines[number + 1 :]:
            if words[-1].endswith(".") or not following or "Departure:" in following:
                break
            words.append(following)
        found.append(" ".join(" ".join(words).split()))
    return found


@pytest.mark.parametrize("page", [*PAGES, *RESULTS], ids=lambda page: page.name)
def test_links_lead_to_files(page):
    targets = re.findall(r"\]\(([^)#\s]+)", page.read_text())
    missing = [t for t in targets if "://" not in t and not (page.parent / t).exists()]
    assert not missing


COMMANDS = sorted(
    {
        (match[1], match[2].partition("  #")[0].strip())
        for page in PAGES
        for match in re.finditer(
            r"(?:^    |`)(?:\S+=\S+ )?python scripts/(train|identify|evaluate|check|export|rig|ablation|report)\.py"
            r"([^\n`&]*)",
            page.read_text().replace("\\\n", " "),
            re.M,
        )
    }
)
OF_OTHERS = re.compile(r"NAME|servo|mine|my_|--config-dir|swing_up|\.\.\.|PATH$")
"""Words for what a reader puts in, or writes first."""


@pytest.mark.parametrize("page", [*PAGES, *RESULTS], ids=lambda page: page.name)
def test_blocks_of_code_are_no_wider_than_a_page_shows(page):
    fenced = re.findall(r"^ *```\w*\n(.*?)^ *```$", page.read_text(), re.M | re.S)
    indented = re.findall(r"(?:(?<=\n\n)|\A)((?: {4}.*\n|\n(?= {4}))+)", page.read_text())
    blocks = [*fenced, *(re.sub("^ {4}", "", text, flags=re.M) for text in indented)]
    assert [line for text in blocks for line in text.splitlines() if len(line) > 88] == []


def test_commands_are_found():
    assert len(COMMANDS) > 30


@pytest.mark.parametrize(("command", "words"), COMMANDS)
def test_a_command_of_a_page_is_one_that_its_config_takes(command, words):
    overrides = [word for word in shlex.split(words) if "=" in word]
    OverridesParser.create().parse_overrides(overrides)
    if words.startswith("-m") or "hydra/" in words or OF_OTHERS.search(words):
        return
    composed(command, *overrides)


def test_the_citation_is_of_this_version_and_names_the_authors_of_the_paper():
    cited = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= set(cited)  # what the format asks for
    assert cited["version"] == dynasindy.__version__
    paper = cited["preferred-citation"]
    authors = [f"{author['given-names']} {author['family-names']}" for author in paper["authors"]]
    assert authors == ["Karim Abdelsalam", "Zeyad Gamal", "Ayman El-Badawy"]
    for page in (README, ALGORITHM):
        text = " ".join(page.read_text().split())
        assert paper["url"] in text and f"*{paper['title']}*" in text
        assert all(author in text for author in authors)
    assert f"\n## {cited['version']}\n" in (REPOSITORY / "CHANGELOG.md").read_text()


def test_departures_are_collected_from_comments_and_docstrings():
    text = "# Departure: the paper does a;\n# we do b.\nx = 1\n    Departure: no c here.\n    More words.\n"
    assert departures(text) == ["the paper does a; we do b.", "no c here."]


def test_algorithm_page_lists_every_departure_and_no_other():
    in_code = {f"`{path.relative_to(REPOSITORY)}`: {text}" for path in SOURCES for text in departures(path.read_text())}
    section = ALGORITHM.read_text().partition("## Departures")[2]
    listed = {" ".join(item.split()) for item in re.findall(r"^- (.+?)(?=\n- |\n\n|\Z)", section, re.M | re.S)}
    assert listed == in_code


@pytest.mark.parametrize(
    ("overrides", "column"), [(["experiment=paper"], 0), (["experiment=dyna"], 1)], ids=["paper", "dyna"]
)
def test_algorithm_page_shows_the_values_of_the_configs(overrides, column):
    config = composed("train", *overrides)
    rows = re.findall(r"\| `([\w.]+)` \| ([^|]+) \| ([^|]+) \|$", ALGORITHM.read_text(), re.M)
    assert len(rows) > 11  # the rows of the paper's table, and what its text sets
    shown = {key: OmegaConf.create(f"value: {values[column]}").value for key, *values in rows}
    assert shown == {key: OmegaConf.select(config, key) for key in shown}
