"""Try small changes of the code against its tests: `python tests/mutation.py systems --sample 60 --seed 0`.

Cosmic Ray makes the mutants and keeps the session; docs/testing.md says how to read it. Here are the parts that this
repository adds: two operators, a seeded sample with one mutant per place, and a trial in a forked process that has
torch imported already, sees the mutant through the import system (no file is written) and stops at the first failure.
"""

import argparse
import ast
import contextlib
import difflib
import gc
import importlib
import os
import random
import re
import resource
import signal
import sys
import traceback
from importlib.machinery import SourceFileLoader
from importlib.metadata import entry_points
from pathlib import Path

os.environ |= {"OMP_NUM_THREADS": "1", "RL_LOGGING_LEVEL": "WARNING", "MPLBACKEND": "Agg"}

import cosmic_ray.plugins
import pytest
from cosmic_ray.commands.init import init
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Operator
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import MutationSpec, TestOutcome, WorkerOutcome, WorkItem, WorkResult
from parso.python.tree import Keyword

ROOT = Path(__file__).parents[1]
IMPORTED = ("torchrl.envs", "torchrl.objectives", "torchrl.modules", "scipy.optimize", "sympy", "pysindy", "casadi")
SWAPPED = ("arglist", "testlist_comp", "testlist_star_expr", "exprlist", "dictorsetmaker")
# What cannot bite or is caught at once is left out: shifts, remainders and powers of floats; `<` for `!=` and so on.
LEFT_OUT = re.compile(
    r"(Replace(BinaryOperator_\w*_(FloorDiv|Mod|Pow|RShift|LShift|BitXor)|ComparisonOperator_\w*_Is\w*"
    r"|ComparisonOperator_Is\w*)|RemoveDecorator|VariableInserter)$"
)


# Pictures are judged by eye: a pixel more or less is no mistake.
PICTURES = ("drawing.py",)


class ExchangeNeighbours(Operator):
    """Exchange two arguments, targets or elements that follow each other, or the values of two keys."""

    def mutation_positions(self, node):
        yield from ((node.children[i].start_pos, node.children[j].end_pos) for i, j in self._pairs(node))

    def mutate(self, node, index):
        i, j = self._pairs(node)[index]
        node.children[i], node.children[j] = node.children[j], node.children[i]
        return node

    def _pairs(self, node):
        if node.type not in SWAPPED:
            return []
        step = 4 if node.type == "dictorsetmaker" and str(node.children[1].get_code()).strip() == ":" else 2
        places = range(2 if step == 4 else 0, len(node.children) - step, step)
        return [(i, i + step) for i in places if self._differ(node.children[i], node.children[i + step])]

    def _differ(self, a, b):
        named = any(n.type in ("argument", "sync_comp_for", "comp_for", "string") for n in (a, b))
        return not named and a.get_code().strip() != b.get_code().strip()

    @classmethod
    def examples(cls):
        return ()


class DropStatement(Operator):
    """Drop a call, an update or the assignment of an attribute or element."""

    def mutation_positions(self, node):
        if node.type == "simple_stmt":
            parts = getattr(node.children[0], "children", [None, None])
            assigns = node.children[0].type == "expr_stmt" and (parts[0].type != "name" or parts[1].type == "operator")
            updates = assigns and (parts[0].type != "name" or parts[1].get_code().strip() != "=")
            calls = node.children[0].type == "atom_expr" and parts[-1].get_code().endswith(")")
            if updates or calls:
                yield node.start_pos, node.end_pos

    def mutate(self, node, index):
        first = node.children[0]
        node.children[0] = Keyword("pass", first.start_pos, first.get_first_leaf().prefix)
        return node

    @classmethod
    def examples(cls):
        return ()


class Silent(ast.NodeTransformer):
    """Take out what no test should hold fast: annotations, docstrings, the words of an error, and guards of a reader.

    That two lists are as long as each other (`strict`) and that nothing changes a record (`frozen`) decides nothing.
    """

    def visit_keyword(self, node):
        return None if node.arg in ("strict", "frozen") else self.generic_visit(node)

    def visit_Expr(self, node):
        return None if isinstance(node.value, ast.Constant) else self.generic_visit(node)

    def visit_AnnAssign(self, node):
        node.annotation = ast.Constant(0)
        return self.generic_visit(node)

    def visit_arg(self, node):
        node.annotation = None
        return node

    def visit_FunctionDef(self, node):
        node.returns = None
        return self.generic_visit(node)

    def visit_Raise(self, node):
        node.exc = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
        return node


def meaning(source):
    return ast.dump(Silent().visit(ast.parse(source)))


def mutated(mutation):
    operator = cosmic_ray.plugins.get_operator(mutation.operator_name)(**mutation.operator_args)
    return mutate_code(mutation.module_path.read_text(), operator, mutation.occurrence)


def bites(mutation):
    """Whether a mutant compiles and changes more than words and annotations."""
    with contextlib.suppress(SyntaxError):
        return meaning(mutated(mutation)) != meaning(mutation.module_path.read_text())
    return False


def sample(modules, size, seed):
    """Draw places of the code, then one mutation of each."""
    everything = WorkDB(":memory:", WorkDB.Mode.create)
    init(modules, everything, {})
    places = {}
    for item in everything.work_items:
        if not LEFT_OUT.search(item.mutations[0].operator_name):
            places.setdefault((str(item.mutations[0].module_path), *item.mutations[0].start_pos), []).append(item)
    rng, drawn = random.Random(seed), []
    for place in rng.sample(sorted(places), len(places)):
        items = sorted(places[place], key=lambda item: (item.mutations[0].operator_name, item.mutations[0].occurrence))
        item = rng.choice(items)
        if bites(item.mutations[0]):
            drawn.append(WorkItem(f"{len(drawn):04d}", item.mutations))
        if len(drawn) == size:
            break
    return drawn


def test_files(module):
    """The file that mirrors a module, then the folder in which it is."""
    inside = module.relative_to("dynasindy")
    mirror = Path("tests", inside.parent, f"test_{inside.name}")
    return [str(mirror)] * mirror.exists(), str(Path("tests", inside.parent))


def run_tests(module, source, contract):
    """Run in the child: import the mutant in place of its file, and return what pytest says."""
    path, compiled = str(module.resolve()), SourceFileLoader.get_code
    SourceFileLoader.get_code = lambda self, name: (
        compile(source, path, "exec", dont_inherit=True) if self.path == path and source else compiled(self, name)
    )
    options = ["-x", "-q", "--no-header", "--tb=line", "-p", "no:cacheprovider"]
    mirror, room = test_files(module)
    code = pytest.main([*options, *mirror]) if mirror else 0
    code = code or pytest.main([*options, room, *(f"--ignore={path}" for path in mirror)])
    return code or (contract and pytest.main([*options, "-m", "not slow", "tests/contract"]))


def warm_up():
    """Import what every child needs, but nothing of this repository, and take it out of the garbage collector's way."""
    for name in (*IMPORTED, *(plugin.module for plugin in entry_points(group="pytest11"))):
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
        pytest.main(["--version"])
    gc.collect()
    gc.freeze()


def attempt(module, source, seconds, contract):
    """Return the status of a forked run, what it printed and its CPU time; it dies of a signal when that is up."""
    reader, writer = os.pipe()
    if (child := os.fork()) == 0:
        code = 1
        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            os.dup2(writer, 1)
            os.close(reader)
            resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
            signal.alarm(60 * seconds)
            code = int(run_tests(module, source, contract))
        except BaseException:
            traceback.print_exc(file=sys.stdout)
        finally:
            sys.stdout.flush()
            os._exit(code)
    os.close(writer)
    with open(reader, errors="replace") as output:
        printed = output.read()
    _, status, used = os.wait4(child, 0)
    return status, printed, used.ru_utime + used.ru_stime


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "rooms", nargs="+", help="folders of dynasindy, such as systems, or files, such as data/clock.py"
    )
    parser.add_argument("--sample", type=int, default=60, help="number of mutants")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sample")
    parser.add_argument("--again", action="store_true", help="try the survivors of the session again")
    parser.add_argument("--quick", action="store_true", help="neither tests without a mutant first, nor the contract")
    parser.add_argument(
        "--seconds", type=int, default=400, help="CPU time of one mutant, after which it counts as killed"
    )
    given = parser.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    operators = {operator.__name__: operator for operator in (ExchangeNeighbours, DropStatement)}
    cosmic_ray.plugins.OPERATOR_PROVIDERS["ours"] = operators
    named = re.sub(r"\W+", "-", "-".join(given.rooms))
    session = Path("outputs", "mutation", f"{named}-{given.sample}-{given.seed}.sqlite")
    session.parent.mkdir(parents=True, exist_ok=True)
    with use_db(str(session)) as database:
        if not database.num_work_items:
            given_places = [place for room in given.rooms for place in Path("dynasindy").glob(room)]
            files = {file for place in given_places for file in (place, *place.rglob("*.py")) if file.suffix == ".py"}
            modules = sorted(file for file in files if file.name not in PICTURES)
            database.add_work_items(sample(modules, given.sample, given.seed))
        warm_up()
        folders = {item.mutations[0].module_path.parent for item in database.work_items}
        for folder in [] if given.again or given.quick else sorted(folders):
            status, output, _ = attempt(folder / "__init__.py", None, 900, contract=folder == min(folders))
            if status:
                sys.exit(f"the tests of {folder} fail without any mutant; mend them first\n{output[-2000:]}")
        todo = {item.job_id: item for item in database.pending_work_items}
        if given.again:
            todo |= {item.job_id: item for item, result in database.completed_work_items if not result.is_killed}
        for job, item in sorted(todo.items()):
            mutation: MutationSpec = item.mutations[0]
            source, original = mutated(mutation), mutation.module_path.read_text()
            status, output, used = attempt(mutation.module_path, source, given.seconds, contract=not given.quick)
            outcome = TestOutcome.KILLED if status else TestOutcome.SURVIVED
            lines = difflib.unified_diff(original.splitlines(), source.splitlines(), n=0, lineterm="")
            diff = "\n".join(list(lines)[3:])
            database.set_result(job, WorkResult(WorkerOutcome.NORMAL, output[-2000:], outcome, diff))
            print(job, outcome.value, f"{mutation.module_path}:{mutation.start_pos[0]}", f"{used:.1f} s", flush=True)
            if not status:
                print(diff, flush=True)
        survived = sum(not result.is_killed for _, result in database.results)
        print(f"{' '.join(given.rooms)}: {database.num_results - survived} of {database.num_results} mutants killed")


if __name__ == "__main__":
    main()
