"""What the documents refer to as the public API exists, is typed and is documented; the examples in docstrings hold."""

import ast
import doctest
import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import dynasindy

REPOSITORY = Path(__file__).parents[1]
PAGES = [*sorted(REPOSITORY.glob("*.md")), *sorted((REPOSITORY / "docs").rglob("*.md"))]
CONFIGS = sorted((REPOSITORY / "conf").rglob("*.yaml"))
DOTTED = re.compile(r"\bdynasindy(?:\.[A-Za-z_]\w*)+")
FILE = re.compile(r"\bdynasindy(?:/\w+)*/\w+(?=\.py\b)")
"""A file that a page tells the reader to write, as in `# dynasindy/systems/servo.py`."""


def imported(page: str) -> Iterator[str]:
    """The names that a page's blocks of Python import from the package."""
    for block in re.findall(r"^```python\n(.*?)^```", page, re.S | re.M):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "dynasindy":
                yield from (f"{node.module}.{alias.name}" for alias in node.names)


def referenced() -> set[str]:
    """The public names of the package that README, docs and configs import, link or instantiate."""
    names = {f"dynasindy.{name}" for name in dynasindy.__all__}
    for path in CONFIGS:
        names.update(DOTTED.findall(path.read_text()))
    for path in PAGES:
        text = path.read_text()
        written = {file.replace("/", ".") for file in FILE.findall(text) if not (REPOSITORY / f"{file}.py").exists()}
        names.update(name for name in {*imported(text), *DOTTED.findall(text)} if not is_in(name, written))
    return names


def is_in(name: str, modules: set[str]) -> bool:
    return any(name == module or name.startswith(f"{module}.") for module in modules)


def resolved(name: str) -> Any:
    """The module, class, function or value of a dotted name."""
    parts = name.split(".")
    thing = importlib.import_module(parts[0])
    for number, part in enumerate(parts[1:], 2):
        if not hasattr(thing, part):
            importlib.import_module(".".join(parts[:number]))
        thing = getattr(thing, part)
    return thing


def undocumented(thing: Any) -> list[str]:
    """What of a public class or function has no docstring; inherited words count."""
    if inspect.isclass(thing):
        members = [getattr(value, "fget", value) for value in public_members(thing)]
        return [owner.__qualname__ for owner in (thing, *members) if not inspect.getdoc(owner)]
    return [] if inspect.getdoc(thing) else [getattr(thing, "__qualname__", repr(thing))]


def untyped(thing: Any) -> list[str]:
    """Public functions, methods and constructors with an argument or a result that is not annotated."""
    members = [thing]
    if inspect.isclass(thing):
        members = [getattr(value, "fget", value) for value in public_members(thing)]
        members += [thing.__init__] if "__init__" in vars(thing) else []
    return [member.__qualname__ for member in members if inspect.isfunction(member) and lacks_type(member)]


def lacks_type(function: Any) -> bool:
    signature = inspect.signature(function)
    named = [p for name, p in signature.parameters.items() if name not in ("self", "cls")]
    return inspect.Signature.empty in (signature.return_annotation, *(p.annotation for p in named))


def public_members(cls: type) -> list[Any]:
    """The methods and properties that a class of the package defines itself, without what dataclasses generate."""
    own = {name: getattr(value, "__func__", value) for name, value in vars(cls).items() if not name.startswith("_")}
    return [value for value in own.values() if inspect.isfunction(value) or isinstance(value, property)]


def misplaced(thing: Any) -> list[str]:
    """Dataclasses that document `Args:`: their fields are read, too, and stand under `Attributes:`."""
    marked = inspect.isclass(thing) and "__dataclass_fields__" in vars(thing)
    return [thing.__qualname__] if marked and "Args:" in (thing.__doc__ or "") else []


RULES = [undocumented, untyped, misplaced]
API = sorted(referenced())


def test_what_documents_refer_to_exists():
    missing = []
    for name in API:
        try:
            resolved(name)
        except (ImportError, AttributeError) as error:
            missing.append(f"{name}: {error}")
    assert not missing, "\n".join(missing)


@pytest.mark.parametrize("rule", RULES)
def test_the_public_api_keeps_the_rule(rule):
    things = [resolved(name) for name in API]
    broken = {fault for thing in things if inspect.isclass(thing) or inspect.isroutine(thing) for fault in rule(thing)}
    assert len(things) > 80 and not broken, "\n".join(sorted(broken))


def test_every_module_says_what_it_holds():
    paths = sorted((REPOSITORY / "dynasindy").rglob("*.py"))
    bare = [
        str(path) for path in paths if path.read_text().strip() and not ast.get_docstring(ast.parse(path.read_text()))
    ]
    assert paths and not bare


EXAMPLES = [path for path in sorted((REPOSITORY / "dynasindy").rglob("*.py")) if ">>> " in path.read_text()]


def test_the_way_from_a_log_to_a_controller_has_an_example():
    assert Path(inspect.getfile(inspect.unwrap(dynasindy.plan))) in EXAMPLES


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_in_docstrings_say_what_comes_out(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(".".join(path.relative_to(REPOSITORY).with_suffix("").parts))
    tried = doctest.testmod(module, optionflags=doctest.ELLIPSIS)
    assert tried.attempted and not tried.failed
