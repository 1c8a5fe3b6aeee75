"""What the site has beyond the pages in docs/: every key of conf/, the reference, the notebooks, and links that hold.

The pages in docs/ link to code and configs as they lie in the repository. On the site these links lead to the pages
that are generated here; a link to a file that the site does not have becomes plain text.
"""

import pkgutil
import posixpath
import pydoc
import re
from collections.abc import Callable, Iterator
from inspect import isclass, isfunction, ismodule
from pathlib import Path
from typing import Any

import config_pages
import notebooks
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import dynasindy

REPOSITORY = config_pages.REPOSITORY
DOCS = REPOSITORY / "docs"
ROOT_PAGES = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
"""Files at the top of the repository that are pages of the site."""
SETTINGS, REFERENCE, NOTEBOOKS = "settings", "reference", "notebooks"
"""Folders of the pages that are generated."""
FENCED = re.compile(r"(^ *(`{3,}).*?^ *\2$)", re.M | re.S)
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s#]*)(#[^)\s]*)?\)")
MATH = re.compile(r"\$`([^`]+)`\$")
MATH_BLOCK = re.compile(r"^```math\n(.*?)^```$", re.M | re.S)
"""Formulas as GitHub sets them."""
NAME = re.compile(r"(?<![\[`])`(dynasindy(?:\.\w+)+)`(?![\]`])")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the generated pages where the navigation names their folders."""
    places = {
        f"{SETTINGS}/": [{title: f"{SETTINGS}/{name}.md"} for name, title in config_pages.titles().items()],
        f"{REFERENCE}/": [{room: f"{REFERENCE}/{room}.md"} for room in rooms()],
    }
    config.nav = _filled(config.nav, places)
    return config


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
    return _outside_code(markdown, lambda text: NAME.sub(_named, LINK.sub(_linked(source, here), _formulas(text))))


def _formulas(text: str) -> str:
    return MATH.sub(lambda found: convert(found[1]), text)


def generated() -> Iterator[tuple[str, str]]:
    """Yield path and text of each generated page."""
    for name in config_pages.titles():
        yield f"{SETTINGS}/{name}.md", config_pages.page(name)
    for room, modules in rooms().items():
        yield f"{REFERENCE}/{room}.md", _reference(room, modules)
    for notebook in sorted((DOCS / NOTEBOOKS).glob("*.ipynb")):
        yield f"{NOTEBOOKS}/{notebook.stem}.md", notebooks.page_of(notebook)
    for name, path in ROOT_PAGES.items():
        yield path, (REPOSITORY / name).read_text()


def rooms() -> dict[str, list[str]]:
    """Return the modules of each part of the package, the package itself first."""
    names = sorted(m.name for m in pkgutil.walk_packages(dynasindy.__path__, "dynasindy."))
    public = [name for name in names if not any(part.startswith("_") for part in name.split("."))]
    tops = [name for name in public if name.count(".") == 1]
    return {"dynasindy": []} | {top: [name for name in public if name.startswith(f"{top}.")] for top in tops}


def _reference(room: str, modules: list[str]) -> str:
    """Return the page of a part of the package, in the words of mkdocstrings."""
    alone = not modules and room != "dynasindy"
    head = f"# {room} {{ #{room} }}\n\n::: {room}\n    options:\n      show_root_heading: false\n"
    head += "      show_root_toc_entry: false\n"
    head += "" if alone else "      members: false\n"
    parts = [f"::: {name}\n    options:\n      heading_level: 2\n" for name in modules]
    return "\n".join([head, *(_front() if room == "dynasindy" else parts)])


def _front() -> Iterator[str]:
    """Yield what the package itself offers, which stands in its rooms."""
    for name in dynasindy.__all__:
        if callable(thing := getattr(dynasindy, name)):
            words = (thing.__doc__ or "").partition("\n")[0]
            yield f"* [`dynasindy.{name}`][{thing.__module__}.{thing.__qualname__}]: {words}"


def _filled(nav: Any, places: dict[str, list[Any]]) -> Any:
    """Return the navigation with pages in place of the folders that it names."""
    if isinstance(nav, list):
        return [_filled(entry, places) for entry in nav]
    if isinstance(nav, dict):
        return {title: _filled(entry, places) for title, entry in nav.items()}
    return places.get(nav, nav)


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
        if path.startswith("dynasindy"):
            return f"[{text}][{path.removesuffix('.py').replace('/', '.')}]"
        place = _place(path)
        if place is None:
            return text
        place, _, fragment = place.partition("#")
        anchor = anchor or (f"#{fragment}" if fragment else "")
        return f"{mark}[{text}]({posixpath.relpath(place, posixpath.dirname(here) or '.')}{anchor})"

    return change


def _place(path: str) -> str | None:
    """Return the page or file of the site for a path of the repository, None if there is none."""
    if path in ROOT_PAGES:
        return ROOT_PAGES[path]
    first, _, rest = path.partition("/")
    if first == "conf" and Path(rest).parts[:1] != ("hydra",):
        group, stem = str(Path(rest).parent), Path(rest).stem.lstrip("_")
        whole = (REPOSITORY / path).is_dir()
        page = "commands" if group == "." and not (whole and rest) else rest if whole else group
        return f"{SETTINGS}/{page}.md" + ("" if whole else f"#{stem}")
    if first == "scripts":
        known = (config_pages.CONF / Path(rest).name).with_suffix(".yaml").is_file()
        return f"{SETTINGS}/commands.md" + (f"#{Path(rest).stem}" if known else "")
    if first == "docs" and not rest.startswith("site"):
        if (REPOSITORY / path).is_dir():
            return f"{rest}/README.md" if (REPOSITORY / path / "README.md").is_file() else None
        return rest.removesuffix(".ipynb") + ".md" if rest.endswith(".ipynb") else rest
    return None


def _named(found: re.Match[str]) -> str:
    """Return a name of the package as a link to where the reference describes it, which is where it is defined."""
    thing = pydoc.locate(found[1])
    if ismodule(thing):
        return f"[{found[0]}][{thing.__name__}]"
    if not (isclass(thing) or isfunction(thing)) or not thing.__module__.startswith("dynasindy"):
        return found[0]
    return f"[{found[0]}][{thing.__module__}.{thing.__qualname__}]"
