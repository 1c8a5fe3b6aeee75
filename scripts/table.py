"""Print the table of a sweep, in Markdown for a file: `python scripts/table.py runs/SWEEP`, the folder it printed."""

import sys
from pathlib import Path

from cli import HELP, pipe_guard, program, purpose


def main() -> None:
    """Print the table of the folder that the command line names."""
    with pipe_guard():
        if set(HELP) & set(sys.argv):
            print(purpose("table"))
            return
        from command import one_line

        with one_line():
            if len(sys.argv) != 2:
                raise ValueError(f"give one folder, that of a sweep: {program('table')} runs/SWEEP")
            from dynasindy.evaluation.ablation import sweep_table
            from dynasindy.progress import say

            say(sweep_table(Path(sys.argv[1])))


if __name__ == "__main__":
    main()
