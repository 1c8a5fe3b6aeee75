"""The site builds without a warning, and its generated pages say of every setting what configs and code say."""

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

REPOSITORY = Path(__file__).parents[1]
CONF = REPOSITORY / "conf"
SITE = REPOSITORY / "docs" / "site"
FILES = sorted(CONF.rglob("*.yaml"))
NEEDED = ("mkdocs", "material", "mkdocstrings", "latex2mathml")


def loaded(name):
    """Return a module of the site, which is no package."""
    spec = importlib.util.spec_from_file_location(f"site_{name}", SITE / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    path = list(sys.path)
    sys.modules[f"site_{name}"] = module
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path[:] = path
    return module


@pytest.fixture(scope="module")
def settings():
    """The module that writes the pages on settings."""
    return loaded("config_pages")


def notebook(folder, *sources):
    """Write a notebook of Markdown where a source begins with #, else of code."""
    cells = [{"cell_type": "markdown" if text[0] == "#" else "code", "source": [text]} for text in sources]
    (folder / "a.ipynb").write_text(json.dumps({"cells": cells}))
    return folder / "a.ipynb"


def test_a_notebook_s_page_shows_below_each_cell_what_it_prints_and_draws(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    draws = "class A:\n    def __repr__(self): return 'a \"thing\"'\n    def _repr_png_(self): return b'png'\nA()"
    file = notebook(tmp_path, "# Title", "a = 1\nopen('kept.txt', 'w').close()", "print(f'<{a + 1}>')", draws, "a, 2")
    loaded("notebooks").write(file)
    parts = loaded("notebooks").page_of(file).split("\n\n")
    assert parts[:2] == ["# Title", "```python\na = 1\nopen('kept.txt', 'w').close()\n```"]
    assert parts[3] == "<pre><code>&lt;2&gt;</code></pre>" and parts[7] == "<pre><code>(1, 2)</code></pre>"
    assert parts[5] == '<img alt="a &quot;thing&quot;" src="data:image/png;base64,cG5n">'
    assert parts[8] == '<a href="../a.ipynb" download>Download this notebook</a>\n'
    assert [path.name for path in tmp_path.iterdir()] == ["a.ipynb"] and Path.cwd() == tmp_path
    counts = [cell.get("execution_count") for cell in json.loads(file.read_text())["cells"]]
    assert counts == [None, 1, 2, 3, 4]
    with pytest.raises(ZeroDivisionError):
        loaded("notebooks").write(notebook(tmp_path, "1 / 0"))


def leaves(tree, place=""):
    """Return the paths of all values of a YAML tree, but for lists of groups, whose keys are explained one by one."""
    if isinstance(tree, list) and any(isinstance(child, dict) for child in tree):
        return set()
    if not isinstance(tree, dict) or not tree:
        return {place}
    return {leaf for name, child in tree.items() for leaf in leaves(child, f"{place}.{name}".lstrip("."))}


@pytest.mark.parametrize("file", FILES, ids=lambda file: f"{file.parent.name}/{file.stem}")
def test_every_value_of_a_config_has_a_row_with_a_sentence(settings, file):
    rows = list(settings.explained(file))
    names = {row.name for row in rows}
    wanted = {
        leaf
        for leaf in leaves(yaml.safe_load(file.read_text()) or {})
        if not {"_target_", "_partial_", "defaults", "hydra"} & set(re.split(r"[.]", leaf)) and leaf
    }
    missing = {leaf for leaf in wanted if not any(leaf == name or leaf.startswith(f"{name}.") for name in names)}
    assert not missing
    assert all(row.comment.strip() for row in rows)


def test_a_comment_is_the_sentence_of_the_key_below_it_and_an_argument_that_of_its_docstring(settings, tmp_path):
    file = tmp_path / "some.yaml"
    file.write_text(
        "# What the file is for.\n"
        "_target_: dynasindy.planning.Gate\n"
        "# Read here.\n"
        "open_below: 0.05\n"
        "close_above: 0.1\n"
        "other:\n"
        "  # Deeper, over\n"
        "  # two lines.\n"
        "  key: [1, 2]  # not this\n"
    )
    found = {key.name: key for key in settings.explained(file)}
    assert list(found) == ["open_below", "close_above", "other.key"]
    assert found["open_below"].comment == "Read here."
    assert found["close_above"].comment.startswith("Reward error per control period above which an open gate closes")
    assert found["other.key"].comment == "Deeper, over two lines."
    assert (found["other.key"].value, found["open_below"].value) == ("[1, 2]", "0.05")
    assert settings.heading(file) == "What the file is for."


def test_links_to_configs_lead_to_sections_of_the_page_on_settings(settings):
    anchors = re.findall(r"\{ #([\w-]+) \}$", settings.page(), re.M)
    assert len(anchors) == len(set(anchors))
    assert {settings.anchor(file) for file in FILES} | {file.name for file in CONF.iterdir() if file.is_dir()} <= set(
        anchors
    )


def referenced():
    """Yield names of the reference, each with the members that it lists."""
    for names in yaml.safe_load((SITE / "reference.yml").read_text()).values():
        for entry in names:
            yield from entry.items() if isinstance(entry, dict) else [(entry, [])]


@pytest.mark.slow
@pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in NEEDED),
    reason="MkDocs is not installed: pip install -e '.[docs]'",
)
def test_the_site_builds_without_a_warning_and_its_links_hold(tmp_path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", str(SITE / "mkdocs.yml"), "-d", str(tmp_path)]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "index.html").is_file()
    pages = {page for page in tmp_path.rglob("*.html") if page.name != "404.html"}
    broken = set()
    for page in pages:
        for target in re.findall(r'(?:href|src)="([^"#?]+)', page.read_text()):
            if "://" in target or target.startswith(("data:", "mailto:", "/")):
                continue
            place = (page.parent / target).resolve()
            if not (place.is_file() or (place / "index.html").is_file()):
                broken.add((str(page.relative_to(tmp_path)), target))
    assert not broken
    reference = (tmp_path / "reference" / "index.html").read_text()
    assert not [name for name, _ in referenced() if f'id="{name}"' not in reference]
    assert "steady_state_error" in (tmp_path / "metrics" / "index.html").read_text()
