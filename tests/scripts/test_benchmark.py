"""The dispatcher of the benchmarks."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "benchmark.py"


@pytest.mark.parametrize("argv", [[], ["td4"]])
def test_unknown_benchmark_gets_one_line_that_names_the_known_ones(argv):
    done = subprocess.run([sys.executable, SCRIPT, *argv], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "gradient" in done.stderr and "rigs" in done.stderr and "common" not in done.stderr
    assert (argv[0] if argv else "none") in done.stderr
