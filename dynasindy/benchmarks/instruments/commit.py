"""Which code a row was measured with."""

from __future__ import annotations

import subprocess
from pathlib import Path

RESULTS = ":(top,exclude)docs/results"
"""Tables that a benchmark appends to: its first row does not change the code that measures the second."""


def commit() -> str:
    """Return the commit of the checkout, with `-dirty` where its code was changed, "unknown" outside of one."""
    git = ["git", "-C", str(Path(__file__).parent)]
    try:
        # An installed package may lie in a checkout of something else, which does not track its files.
        subprocess.run([*git, "ls-files", "--error-unmatch", __file__], capture_output=True, check=True)
        asked = [*git, "describe", "--always", "--exclude", "*"]
        name = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
        changed = subprocess.run([*git, "diff", "--quiet", "HEAD", "--", ":(top)", RESULTS], capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{name}-dirty" if changed.returncode else name
