"""Print a sweep as a Markdown table: `python scripts/table.py runs/DATE_TIME`."""

import sys
from pathlib import Path

from reader import while_read

from dynasindy.evaluation.table import sweep_table

if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("error: give one folder, that of a sweep: python scripts/table.py runs/DATE_TIME")
    with while_read():
        try:
            print(sweep_table(Path(sys.argv[1])))
        except FileNotFoundError as error:
            sys.exit(f"error: {error}")
