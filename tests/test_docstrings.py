"""The package's written rules, read off the source: documented, typed, short, mirrored by tests."""

import ast
import doctest
import importlib
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
PACKAGE = REPOSITORY / "dynasindy"
MODULES = sorted(PACKAGE.rglob("*.py"))
Function = ast.FunctionDef | ast.AsyncFunctionDef

MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60
MAX_ARGUMENTS = 7
VAGUE_NAMES = {"utils", "common", "helpers", "misc"}
CONSTRUCTORS = {"__init__", "__post_init__"}


def functions(tree: ast.AST) -> Iterator[Function]:
    return (node for node in ast.walk(tree) if isinstance(node, Function))


def is_public(name: str) -> bool:
    return not name.startswith("_")


def own_arguments(function: Function) -> list[ast.arg]:
    """All named arguments but self and cls."""
    named = function.args.posonlyargs + function.args.args + function.args.kwonlyargs
    return [argument for argument in named if argument.arg not in ("self", "cls")]


def bare_names(tree: ast.AST) -> list[str]:
    """The module, and public classes and functions in it, that have no docstring."""
    nodes = [node for node in ast.walk(tree) if isinstance(node, Function | ast.ClassDef) and is_public(node.name)]
    names = [f"{node.name}:{node.lineno}" for node in nodes if not ast.get_docstring(node)]
    return names if ast.get_docstring(tree) else ["module", *names]


def untyped_functions(tree: ast.AST) -> list[str]:
    """Public functions and constructors with an argument or a result that is not annotated."""

    def untyped(function: Function) -> bool:
        return function.returns is None or any(a.annotation is None for a in own_arguments(function))

    checked = (f for f in functions(tree) if is_public(f.name) or f.name in CONSTRUCTORS)
    return [f"{f.name}:{f.lineno}" for f in checked if untyped(f)]


def long_functions(tree: ast.AST) -> list[str]:
    """Functions whose length without the docstring is over the limit."""

    def length(function: Function) -> int:
        lines = function.end_lineno - function.lineno + 1
        if ast.get_docstring(function):
            lines -= function.body[0].end_lineno - function.body[0].lineno + 1
        return lines

    return [f"{f.name}:{f.lineno}" for f in functions(tree) if length(f) > MAX_FUNCTION_LINES]


def crowded_functions(tree: ast.AST) -> list[str]:
    """Functions with too many arguments; constructors hold settings, which configs name one by one."""
    return [
        f"{f.name}:{f.lineno}"
        for f in functions(tree)
        if f.name not in CONSTRUCTORS and len(own_arguments(f)) > MAX_ARGUMENTS
    ]


def raised_names(function: Function) -> set[str]:
    """Names of the exceptions a function raises itself."""
    raised = {node.exc for node in ast.walk(function) if isinstance(node, ast.Raise) and node.exc is not None}
    made = {exc.func if isinstance(exc, ast.Call) else exc for exc in raised}
    return {exc.id for exc in made if isinstance(exc, ast.Name) and exc.id[0].isupper()}


def undocumented_raises(tree: ast.AST) -> list[str]:
    """Exceptions of public functions and constructors that no `Raises:` section names."""
    missing = []
    for owner in (node for node in ast.walk(tree) if isinstance(node, ast.Module | ast.ClassDef)):
        for function in (node for node in owner.body if isinstance(node, Function)):
            text = ast.get_docstring(function) or ""
            if function.name in CONSTRUCTORS and isinstance(owner, ast.ClassDef):
                text += "\n" + (ast.get_docstring(owner) or "")
            elif not is_public(function.name):
                continue
            documented = text.partition("Raises:")[2]
            unnamed = sorted(name for name in raised_names(function) if f"{name}:" not in documented)
            missing += [f"{function.name}:{function.lineno} {name}" for name in unnamed]
    return missing


def arguments_of_dataclasses(tree: ast.AST) -> list[str]:
    """Dataclasses that document `Args:`: their fields are read, too, and stand under `Attributes:`."""
    classes = (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    marked = (node for node in classes if any("dataclass" in ast.unparse(mark) for mark in node.decorator_list))
    return [f"{node.name}:{node.lineno}" for node in marked if "Args:" in (ast.get_docstring(node) or "")]


RULES = [
    bare_names,
    untyped_functions,
    long_functions,
    crowded_functions,
    undocumented_raises,
    arguments_of_dataclasses,
]


@pytest.mark.parametrize("rule", RULES)
def test_source_keeps_the_rule(rule):
    trees = {path: ast.parse(path.read_text()) for path in MODULES}
    broken = [f"{path.relative_to(REPOSITORY)}: {name}" for path, tree in trees.items() for name in rule(tree)]
    assert not broken, "\n".join(broken)


def test_files_are_short_and_named_for_what_they_do():
    scripts = sorted((REPOSITORY / "scripts").rglob("*.py"))
    too_long = [str(path) for path in MODULES + scripts if path.read_text().count("\n") > MAX_FILE_LINES]
    vague = [str(path) for path in MODULES if path.stem in VAGUE_NAMES]
    assert not too_long + vague


def test_every_module_is_mirrored_by_a_test():
    modules = [path.relative_to(PACKAGE) for path in MODULES if path.name != "__init__.py"]
    tests = [REPOSITORY / "tests" / module.with_name(f"test_{module.name}") for module in modules]
    missing = [str(path.relative_to(REPOSITORY)) for path in tests if not path.exists()]
    assert not missing, "\n".join(missing)


BROKEN = {
    bare_names: "def f() -> None: ...",
    untyped_functions: '"""M."""\ndef f(x) -> int: return x',
    long_functions: "def f():\n" + "    pass\n" * MAX_FUNCTION_LINES,
    crowded_functions: "def f(a, b, c, d, *, e, g, h, i): ...",
    undocumented_raises: 'class A:\n  """A."""\n  def __init__(self):\n    raise ValueError("no")',
    arguments_of_dataclasses: '@dataclass\nclass A:\n  """A.\n\n  Args:\n    x: X.\n  """\n  x: int',
}


@pytest.mark.parametrize("rule", RULES)
def test_each_rule_notices_when_it_is_broken(rule):
    assert rule(ast.parse(BROKEN[rule]))


def test_rules_accept_a_module_that_keeps_them():
    source = (
        '"""Module."""\n\n\nclass A:\n    """A.\n\n    Raises:\n        ValueError: Always.\n    """\n\n'
        '    def __init__(self, x: int) -> None:\n        raise ValueError(f"got {x}")\n'
    )
    assert not any(rule(ast.parse(source)) for rule in RULES)


EXAMPLES = [path for path in MODULES if ">>> " in path.read_text()]


def test_the_way_from_a_log_to_a_controller_has_an_example():
    assert PACKAGE / "workbench.py" in EXAMPLES


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_in_docstrings_say_what_comes_out(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(".".join(path.relative_to(REPOSITORY).with_suffix("").parts))
    tried = doctest.testmod(module, optionflags=doctest.ELLIPSIS)
    assert tried.attempted and not tried.failed
