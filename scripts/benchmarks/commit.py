"""Which code a row was measured with."""

from __future__ import annotations

import subprocess
from pathlib import Path

RESULTS = ":(top,exclude)docs/results"
"""Tables that a benchmark appends to: its first row does not change the code that measures the second."""


def commit(checkout: Path | None = None) -> str:
    """Return the commit of a checkout, with `-dirty` where its code was changed, "unknown" outside of one.

    Args:
        checkout: its folder; that of this package if omitted.
    """
    git = ["git", "-C", str(checkout or Path(__file__).parent)]
    try:
        # An installed package may lie in a checkout of something else, which does not track its files.
        own = __file__ if checkout is None else "pyproject.toml"
        subprocess.run([*git, "ls-files", "--error-unmatch", own], capture_output=True, check=True)
        asked = [*git, "describe", "--always", "--exclude", "*"]
        name = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
        changed = subprocess.run([*git, "diff", "--quiet", "HEAD", "--", ":(top)", RESULTS], capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{name}-dirty" if changed.returncode else name
