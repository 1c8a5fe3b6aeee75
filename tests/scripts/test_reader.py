"""Scripts behind a pipe whose reader leaves, as `head` does."""

import os
import subprocess
import sys
from pathlib import Path

SCRIPTS = Path(__file__).parents[2] / "scripts"


def unread(*arguments, cwd):
    """Run Python with an output that has lost its reader before the first line; return exit code and stderr."""
    ours = [sys.executable, *arguments]
    environment = {**os.environ, "PYTHONPATH": str(SCRIPTS)}
    with subprocess.Popen(
        ours, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=cwd, env=environment
    ) as process:
        process.stdout.close()
        error = process.stderr.read()
    return process.returncode, error


def test_so_does_a_script_that_exits(tmp_path):
    code = "import sys\nfrom cli import pipe_guard\nwith pipe_guard():\n    print('read me')\n    sys.exit(0)"
    assert unread("-c", code, cwd=tmp_path) == (141, "")


def test_an_error_is_told_though_nobody_reads_the_output(tmp_path):
    code = "from cli import pipe_guard\nwith pipe_guard():\n    raise RuntimeError('the plant')"
    status, error = unread("-c", code, cwd=tmp_path)
    assert status == 1 and "RuntimeError: the plant" in error


def test_a_pipe_that_is_not_the_output_breaks_loudly(tmp_path):
    code = "from cli import pipe_guard\nwith pipe_guard():\n    raise BrokenPipeError('a worker died')"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(SCRIPTS)}
    )
    assert done.returncode == 1 and "a worker died" in done.stderr
