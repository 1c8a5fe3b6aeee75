"""Print the table of a sweep, in Markdown for a file: `python scripts/table.py runs/SWEEP`, the folder it printed."""

import sys
from pathlib import Path

from cli import HELP, pipe_guard, program, purpose, refuse


def main() -> None:
    """Print the table of the folder that the command line names."""
    with pipe_guard():
        try:
            if set(HELP) & set(sys.argv):
                print(purpose("table"))
                return
            if len(sys.argv) != 2:
                raise ValueError(f"give one folder, that of a sweep: {program('table')} runs/SWEEP")
            from dynasindy.evaluation.statistics import sweep_table
            from dynasindy.progress import say

            say(sweep_table(Path(sys.argv[1])))
        except (FileNotFoundError, ValueError) as error:
            refuse(str(error))


if __name__ == "__main__":
    main()
