"""What the site has beyond the pages in docs/: every key of conf/, the reference, the notebooks, and links that hold.

The pages in docs/ link to code and configs as they lie in the repository. On the site these links lead to the pages
that are generated here; a link to a file that the site does not have, or to a name that the reference does not have,
becomes plain text.
"""

import posixpath
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import config_pages
import notebooks
import yaml
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

REPOSITORY = config_pages.REPOSITORY
DOCS = REPOSITORY / "docs"
REFERENCE = Path(__file__).with_name("reference.yml")
ROOT_PAGES = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
"""Files at the top of the repository that are pages of the site."""
FENCED = re.compile(r"(^ *(`{3,}).*?^ *\2$)", re.M | re.S)
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s#]*)(#[^)\s]*)?\)")
MATH = re.compile(r"\$`([^`]+)`\$")
MATH_BLOCK = re.compile(r"^```math\n(.*?)^```$", re.M | re.S)
"""Formulas as GitHub sets them."""
NAME = re.compile(r"(?<![\[`])`(dynasindy(?:\.\w+)+)`(?![\]`])")
NAMED = r'<autoref identifier="{}" optional>`{}`</autoref>'
"""A name, which is a link where the reference has it."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    for path, content in generated():
        files.append(File.generated(config, path, content=content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links lead to pages of the site, names of the package to the reference, and set formulas as MathML."""
    markdown = MATH_BLOCK.sub(
        lambda block: f'<p markdown="0">{convert(block[1].strip(), display="block")}</p>', markdown
    )
    here = page.file.src_uri
    source = {site: file for file, site in ROOT_PAGES.items()}.get(here, f"docs/{here}")
    return _outside_code(markdown, lambda text: _named(LINK.sub(_linked(source, here), _formulas(text))))


def generated() -> Iterator[tuple[str, str]]:
    """Yield path and text of each generated page."""
    yield "settings.md", config_pages.page()
    yield "reference.md", _reference()
    for notebook in sorted((DOCS / "notebooks").glob("*.ipynb")):
        yield f"notebooks/{notebook.stem}.md", notebooks.page_of(notebook)
    for name, path in ROOT_PAGES.items():
        yield path, (REPOSITORY / name).read_text()


def _reference() -> str:
    """Return the page of the public names, in the words of mkdocstrings."""
    parts = ["# Reference"]
    for task, names in yaml.safe_load(REFERENCE.read_text()).items():
        parts.append(f"## {task}")
        for entry in names:
            name, members = next(iter(entry.items())) if isinstance(entry, dict) else (entry, None)
            parts.append(f"::: {name}" + (f"\n    options: {{members: {members}}}" if members else ""))
    return "\n\n".join(parts) + "\n"


def _formulas(text: str) -> str:
    # In a span, as Markdown ends a paragraph where a line begins with <math>.
    return MATH.sub(lambda found: f"<span>{convert(found[1])}</span>", text)


def _named(text: str) -> str:
    return NAME.sub(lambda found: NAMED.format(found[1], found[1]), text)


def _outside_code(text: str, change: Callable[[str], str]) -> str:
    """Change a text but for its blocks of code."""
    parts = FENCED.split(text)  # text, block, its fence, text, ...
    return "".join(change(part) if place % 3 == 0 else part for place, part in enumerate(parts) if place % 3 != 2)


def _linked(source: str, here: str) -> Callable[[re.Match[str]], str]:
    """Return what makes a link of a file in the repository one of the site's."""

    def change(found: re.Match[str]) -> str:
        mark, text, target, anchor = found.groups()
        if not target or "://" in target or target.startswith("mailto:"):
            return found[0]
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
        place = _place(path)
        if place is None:  # a file of the package, whose link may show a name that it defines
            name = text.strip("`")
            module = path.removesuffix(".py").replace("/", ".")
            return NAMED.format(f"{module}.{name}", name) if path.startswith("dynasindy/") and name != text else text
        place, _, fragment = place.partition("#")
        anchor = anchor or (f"#{fragment}" if fragment else "")
        return f"{mark}[{text}]({posixpath.relpath(place, posixpath.dirname(here) or '.')}{anchor})"

    return change


def _place(path: str) -> str | None:
    """Return the page or file of the site for a path of the repository, None if there is none."""
    if path in ROOT_PAGES:
        return ROOT_PAGES[path]
    first, _, rest = path.partition("/")
    if first == "conf":
        return "settings.md" + ("#" + config_pages.anchor(REPOSITORY / path) if rest else "")
    if first == "scripts":
        config = (config_pages.CONF / Path(rest).name).with_suffix(".yaml")
        return f"settings.md#{config_pages.anchor(config)}" if config.is_file() else None
    if first == "docs" and not rest.startswith("site"):
        if (REPOSITORY / path).is_dir():
            return f"{rest}/README.md" if (REPOSITORY / path / "README.md").is_file() else None
        return rest.removesuffix(".ipynb") + ".md" if rest.endswith(".ipynb") else rest
    return None
