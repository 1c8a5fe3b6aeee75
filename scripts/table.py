"""Print a sweep as a Markdown table: `python scripts/table.py runs/SWEEP`, the folder that it printed."""

import sys
from pathlib import Path

from reader import while_read

from dynasindy.evaluation.table import sweep_table

if __name__ == "__main__":
    with while_read():
        try:
            if len(sys.argv) != 2:
                raise ValueError("give one folder, that of a sweep: python scripts/table.py runs/SWEEP")
            print(sweep_table(Path(sys.argv[1])))
        except (FileNotFoundError, ValueError) as error:
            print(f"error: {error}", file=sys.stderr)
            sys.exit(2)
