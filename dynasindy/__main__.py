"""The command `dynasindy`, and `python -m dynasindy`: the scripts of the repository, wherever they were installed."""

import sys
from importlib import import_module
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent


def scripts() -> Path:
    """Return the folder of the scripts: inside an installed package, beside that of a clone.

    Raises:
        FileNotFoundError: There is none.
    """
    inside, beside = PACKAGE / "scripts", PACKAGE.parent / "scripts"
    for folder in (inside, beside):
        if (folder / "cli.py").is_file():
            return folder
    raise FileNotFoundError(f"neither {inside} nor {beside} holds the scripts; install dynasindy again")


def main() -> None:
    """Run the command that the first word names."""
    # First, as Python puts the folder of a script that it is given: the scripts import each other by name.
    sys.path.insert(0, str(scripts()))
    import_module("cli").main()


if __name__ == "__main__":
    main()
