"""What others give: files that are read, names that become files, words that become pages. All of it is data.

A file that cannot be read, or does not hold what its reader expects, costs one line. A name becomes a file only as one
plain component of a path, and text becomes a page only after `escaped`.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import Any

LARGEST = 100_000_000
"""Size beyond which no file is read [bytes]; the longest log of the paper's experiment has a hundredth of it."""
LONGEST = 200
"""Letters that a name of a file may have."""


class DamagedFileError(ValueError):
    """A file is not what its reader expects; the message says which and why."""


@contextmanager
def understood(source: Path | str) -> Iterator[None]:
    """Say in one line that a file is damaged, where what it holds is not what the code within expects.

    Raises:
        DamagedFileError: It is; a file that is missing keeps its own error, and so does one of a function that is not
            known here.
    """
    try:
        yield
    except (DamagedFileError, FileNotFoundError):
        raise
    except KeyError as missing:
        raise _damaged(source, f"it lacks {missing}") from missing
    except RecursionError as error:
        raise _damaged(source, "it is nested too deeply") from error
    except UnicodeDecodeError as error:
        raise _damaged(source, f"it is no UTF-8 text from byte {error.start} on") from error
    except OSError as error:
        raise DamagedFileError(f"{source} cannot be read: {error.strerror}; check what it is") from error
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, csv.Error) as error:
        # It imports torch, which commands that only print their help do without.
        from dynasindy.sindy.functions import FunctionError

        if isinstance(error, FunctionError):
            raise
        raise _damaged(source, " ".join(str(error).split())) from error


def _damaged(source: Path | str, why: str) -> DamagedFileError:
    return DamagedFileError(f"{source} is damaged ({why}); restore it, or make it again")


def read_text(path: Path, largest: int = LARGEST) -> str:
    """Return the text of a file.

    Raises:
        FileNotFoundError: It does not exist.
        DamagedFileError: It is a folder or a device, too large, unreadable, or no UTF-8 text.
    """
    with understood(path):
        size = path.stat().st_size
        if not path.is_file():
            raise DamagedFileError(f"{path} is no file; give a file, or restore it")
        if size > largest:
            raise DamagedFileError(f"{path} has {size} bytes; at most {largest} are read: check what it is")
        return path.read_text(encoding="utf-8")


def read_record(path: Path) -> dict[str, Any]:
    """Return what a JSON file holds, which is keys and values.

    Raises:
        FileNotFoundError: It does not exist.
        DamagedFileError: It cannot be read, or holds something else.
    """
    text = read_text(path)
    with understood(path):
        record = json.loads(text)
        if not isinstance(record, dict):
            why = f"it holds a {type(record).__name__}, not keys and values"
            raise DamagedFileError(f"{path} is damaged ({why}); restore it, or make it again")
        return record


def read_cells(path: Path) -> tuple[list[str], list[list[str]]]:
    """Return the headings of a CSV file and its rows, which are as long; lines without a cell are left out.

    Raises:
        FileNotFoundError: It does not exist.
        DamagedFileError: It cannot be read, has no headings or one twice, or a row is shorter or longer.
    """
    text = read_text(path)
    with understood(path):
        header, *rows = [row for row in csv.reader(StringIO(text, newline=""), strict=True) if row] or [[]]
        if not header or len(set(header)) < len(header):
            why = "its first line is no line of different headings"
            raise DamagedFileError(f"{path} is damaged ({why}); restore it, or make it again")
        wrong = next((place for place, row in enumerate(rows) if len(row) != len(header)), None)
        if wrong is not None:
            why = f"row {wrong + 1} has {len(rows[wrong])} cells under {len(header)} headings"
            raise DamagedFileError(f"{path} is damaged ({why}); restore it, or make it again")
        return header, rows


def plain_name(name: object, what: str) -> str:
    """Return a name that is to be a file's or a folder's, if it can lead nowhere else.

    Args:
        name: The name.
        what: What it names, for the message.

    Raises:
        ValueError: It is not one plain component of a path.
    """
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w.,=+ -]*", name) or len(name) > LONGEST:
        raise ValueError(
            f"{what} '{escaped(str(name)[:LONGEST])}' is no file name; allowed are letters, digits, '_' and, after "
            f"the first, '.,=+-' and spaces, {LONGEST} at most: choose another name"
        )
    return name


def own_folder(folder: Path, name: str) -> Path:
    """Return a folder within a folder that someone gave, to write into.

    Raises:
        ValueError: It, or a file in it, is a link, and what is written there would end up elsewhere.
    """
    target = folder / name
    if target.is_symlink():
        raise ValueError(f"{target} is a link, and may lead anywhere; remove it, then results are written there")
    refuse_links(target)
    return target


def folder_for(given: str | None, run: Path, name: str) -> Path:
    """Return where a command writes: the folder that is given, or one of its own in the run folder, or beside the file.

    Args:
        given: The folder, if one is given.
        run: Run folder, or a file in it.
        name: Name of the command's own folder.

    Raises:
        ValueError: It holds a link, or is one that lies in the run folder.
    """
    if given is None:
        return own_folder(run if run.is_dir() else run.parent, name)
    refuse_links(Path(given))
    return Path(given)


def refuse_links(folder: Path) -> None:
    """Make sure that what is written into a folder, which may itself be a link, stays in it.

    Raises:
        ValueError: The folder holds a link.
    """
    if links := sorted(path for path in folder.rglob("*") if path.is_symlink()):
        raise ValueError(f"{links[0]} is a link, and may lead anywhere; remove it, then results are written there")


def escaped(words: str) -> str:
    """Return text that Markdown takes neither for HTML nor for a link, and that stays on its line."""
    line = re.sub(r"\s*[\x00-\x08\x0a-\x1f\x7f\x85\u2028\u2029]+\s*", " ", words)
    # HTML needs a letter, '/', '!' or '?' behind '<', a link '(' or '[' behind ']', and where a link leads is told by a
    # line that begins with '[': elsewhere they stand as they are.
    return re.sub(r"\](?=[(\[])", r"]\\", re.sub(r"<(?=[A-Za-z/!?])", "&lt;", re.sub(r"^\s*\[", r"\\[", line)))
