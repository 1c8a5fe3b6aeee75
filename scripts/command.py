"""What the scripts share: errors of a user's making become one line."""

import os
import sys
from collections.abc import Callable

os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # errors reach `one_line_errors` instead of Hydra's printer

from hydra.errors import HydraException, InstantiationException
from omegaconf.errors import OmegaConfBaseException

OURS = (ValueError, TypeError, KeyError, FileNotFoundError)


def one_line_errors(main: Callable[[], None]) -> None:
    """Run a Hydra main and print what a user can mend as one line, with exit code 2."""
    try:
        main()
    except (HydraException, OmegaConfBaseException, *OURS) as error:
        if os.environ.get("DYNASINDY_TRACEBACK"):
            raise
        print(f"error: {_words(error)}", file=sys.stderr)
        sys.exit(2)


def _words(error: BaseException) -> str:
    """Return the innermost message of an error of Hydra's, or the message itself, on one line."""
    while isinstance(error, HydraException) and not str(error).strip() and error.__cause__:
        error = error.__cause__
    where = ""
    if isinstance(error, InstantiationException):
        key = str(error).rpartition("full_key: ")[2].strip()
        where = f"{key}: " if "full_key" in str(error) else ""
        while error.__cause__ is not None:
            error = error.__cause__
    return where + " ".join(str(error).strip("'\"").split())
