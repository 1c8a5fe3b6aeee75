"""The command lines of the benchmarks: they name what the benchmarks have, and cost no import of it."""

import subprocess
import sys
from importlib import import_module

import pytest
from benchmarks.arguments import OPTIONS, names, parsed, told

EVERY_HELP = """
import contextlib, io, sys
sys.path.insert(0, "scripts")
from benchmark import names, run
for name in names():
    with contextlib.redirect_stdout(io.StringIO()) as page, contextlib.suppress(SystemExit):
        run([name, "--help"])
    assert "--out" in page.getvalue(), name
print(*sys.modules)
"""
ORIGINALS = [
    *[
        ("baselines", "--controllers", "CONTROLLERS"),
        ("gradient", "--cases", "CASES"),
        ("gradient", "--plants", "PLANTS"),
    ],
    *[("identify", "--only", "CASES"), ("logs", "--plants", "CASES"), ("model_free", "--agents", "AGENTS")],
    *[("plants", "--plants", "PLANTS"), ("rigs", "--rigs", "RIGS")],
    *[("swing_up", "--plants", "SWINGS"), ("swing_up", "--agents", "AGENTS")],
]


def test_no_help_imports_what_takes_seconds(request):
    done = subprocess.run(
        [sys.executable, "-c", EVERY_HELP], cwd=request.config.rootpath, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    heavy = {"torch", "torchrl", "tensordict", "scipy", "pysindy", "stable_baselines3", "casadi", "matplotlib"}
    assert "argparse" in done.stdout.split() and not heavy & set(done.stdout.split())


def test_every_benchmark_has_its_options_and_says_what_it_measures():
    assert sorted(OPTIONS) == names()
    assert all(len(told(name)) > 20 and "\n" not in told(name) for name in names())


@pytest.mark.parametrize(("benchmark", "option", "original"), ORIGINALS)
def test_what_can_be_chosen_is_what_there_is(benchmark, option, original):
    there = getattr(import_module(f"benchmarks.{benchmark}"), original)
    assert sorted(OPTIONS[benchmark][option]["choices"]) == sorted(there)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("baselines --controllers H-infinity", "invalid choice: 'H-infinity'"),
        ("identify --only venus", "invalid choice: 'venus'"),
        ("speed --jobs start", "invalid choice: 'start'"),
        ("model_free --episodes 0", "0 leaves nothing to evaluate; give 1 or more"),
        ("rigs", "required: --data"),
    ],
)
def test_what_there_is_not_is_refused(words, complaint, capsys):
    name, *rest = words.split()
    with pytest.raises(SystemExit) as stop:
        parsed(name, rest)
    assert stop.value.code == 2 and complaint in capsys.readouterr().err


def test_what_is_not_given_is_what_is_published():
    given = parsed("swing_up", ["--seeds", "7"])
    assert (given.plants, given.seeds, given.steps) == (["pendulum_v1", "swing_up"], [7], None)
    assert str(given.out) == "docs/results/swing_up.csv" and parsed("td3", []).out is None
