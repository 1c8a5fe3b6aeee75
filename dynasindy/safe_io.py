"""Files: reading what others made, and writing whole.

A file that cannot be read, or does not hold what its reader expects, costs one line. A name becomes a file only as one
plain component of a path, and text becomes a page only after `escape_markdown`.

A file is written under a random name beside its place, on which nobody can lay a link beforehand, and then put there at
once: a reader, a second writer, a full disk, a kill or a power cut never meets half of it. A link in its place is
refused, for it may lead anywhere.
"""

from __future__ import annotations

import csv
import json
import os
import re
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import wraps
from inspect import signature
from io import StringIO
from pathlib import Path
from typing import Any, BinaryIO, ParamSpec, TypeVar

from pydantic import ValidationError, validate_call

from dynasindy.text import did_you_mean

P = ParamSpec("P")
T = TypeVar("T")

LARGEST = 100_000_000
"""Size beyond which no file is read [bytes]; the longest log of the paper's experiment has a hundredth of it."""
LONGEST = 200
"""Letters that a name of a file may have."""
Row = dict[str, Any]
MEMBER = re.compile(r"[\w-]+\[.*\]|constrained-\w+|str|int|float|bool")
"""How pydantic calls a member of a union, in the way to a value."""


class FileError(ValueError):
    """A file is not as it has to be; the message names it and says what to do, and needs no more words."""


class DamagedFileError(FileError):
    """A file is not what its reader expects; the message says which and why."""


class LinkError(FileError):
    """A link stands where a file is to be written."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path} is a link, and may lead anywhere; remove it, then results are written there")


@contextmanager
def reading(source: Path | str) -> Iterator[None]:
    """Say in one line that a file is damaged, where what it holds is not what the code within expects.

    Raises:
        DamagedFileError: It is; a file that is missing keeps its own error, and so does a `FileError`.
    """
    try:
        yield
    except (FileError, FileNotFoundError):
        raise
    except KeyError as missing:
        raise _damaged(source, f"it lacks {missing}") from missing
    except OSError as error:
        raise DamagedFileError(f"{source} cannot be read: {error.strerror}; check what it is") from error
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError, csv.Error) as error:
        raise _damaged(source, " ".join(error_text(error).split())) from error


def error_text(error: BaseException, names: Sequence[str] = ()) -> str:
    """Return what an error says; of an argument that its annotation forbids, which of `names` and what is allowed."""
    if not isinstance(error, ValidationError):
        return str(error)
    # Of a union each member says what it wants; the one that comes deepest into the value is most likely meant.
    first = max(error.errors(), key=lambda each: (not each["type"].startswith("missing"), len(each["loc"])))
    steps = [names[int(k)] if k in range(len(names)) else k for k in first["loc"][:1]] + [*first["loc"][1:]]
    place = ".".join(str(step) for step in steps if not MEMBER.fullmatch(str(step)))
    value, owner = " ".join(str(first["input"]).split())[:40], error.title.removesuffix(".__init__")
    if first["type"].startswith("missing"):
        return f"{owner} lacks {place}; give it"
    if first["type"] == "unexpected_keyword_argument" and names:
        allowed = ", ".join(names).removeprefix("self, ")
        return f"{owner} has {place}={value}; allowed are {allowed}{did_you_mean(place, names)}"
    told = re.sub("^Value error, | after validation, .*", "", first["msg"]).replace("Input should be", "allowed is")
    told = told.replace("a valid tuple", "a tuple, such as (-1, 1)")
    mended = f"give {first['input'].__name__}()" if isinstance(first["input"], type) else "correct it"
    return f"{owner} has {place}={value}; {told}: {mended}" if place else told


def checked(function: Callable[P, T]) -> Callable[P, T]:
    """Return a function whose arguments are checked by their annotations; a wrong one costs a line."""
    return _in_a_line(
        validate_call(config={"arbitrary_types_allowed": True})(function), [*signature(function).parameters]
    )


def checked_class(made: type[T]) -> type[T]:
    """Return a dataclass of pydantic, a wrong field of which costs a line."""
    made.__init__ = _in_a_line(made.__init__, [*signature(made).parameters])  # type: ignore[method-assign]
    return made


def _in_a_line(checking: Callable[P, T], names: Sequence[str]) -> Callable[P, T]:
    @wraps(checking)
    def _called(*args: P.args, **keywords: P.kwargs) -> T:
        try:
            return checking(*args, **keywords)
        except ValidationError as error:
            raise ValueError(error_text(error, names)) from None

    return _called


def _damaged(source: Path | str, why: str) -> DamagedFileError:
    return DamagedFileError(f"{source} is damaged ({why}); restore it, or make it again")


def read_text(path: Path, largest: int = LARGEST) -> str:
    """Return the text of a file.

    Raises:
        FileNotFoundError: It does not exist.
        DamagedFileError: It is a folder or a device, too large, unreadable, or no UTF-8 text.
    """
    with reading(path):
        size = path.stat().st_size
        if not path.is_file():
            raise DamagedFileError(f"{path} is no file; give a file, or restore it")
        if size > largest:
            raise DamagedFileError(f"{path} has {size} bytes; at most {largest} are read: check what it is")
        return path.read_text(encoding="utf-8")


def read_json(path: Path) -> dict[str, Any]:
    """Return what a JSON file holds, which is keys and values.

    Raises:
        FileNotFoundError: It does not exist.
        DamagedFileError: It cannot be read, or holds something else.
    """
    text = read_text(path)
    with reading(path):
        record = json.loads(text)
        if not isinstance(record, dict):
            raise _damaged(path, f"it holds a {type(record).__name__}, not keys and values")
        return record


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a CSV file by heading, each cell as text; none if there is no file.

    Raises:
        DamagedFileError: It cannot be read, has no headings or one twice, or a row is shorter or longer.
    """
    if not path.exists():
        return []
    text = read_text(path)
    with reading(path):
        header, *rows = [*csv.reader(StringIO(text, newline=""), strict=True)] or [[]]
        if not header or len(set(header)) < len(header):
            raise _damaged(path, "its first line is no line of different headings")
        for place, row in enumerate(filled := [row for row in rows if row], 1):
            if len(row) != len(header):
                raise _damaged(path, f"row {place} has {len(row)} cells; allowed are {len(header)}, one a heading")
        return [dict(zip(header, row, strict=True)) for row in filled]


@contextmanager
def replace_file(path: str | Path) -> Iterator[BinaryIO]:
    """Give a file to write to, and at the end put it in the place of `path`, all at once.

    Args:
        path: The file; its folder is made if missing.

    Raises:
        LinkError: A link stands there.
        FileError: A device or a pipe does.
        OSError: The file cannot be written; the earlier one stays.
    """
    path = Path(path)
    temporary = path.with_name(f".{secrets.token_hex(8)}.tmp")
    if path.is_symlink():
        raise LinkError(path)
    if path.exists() and not (path.is_file() or path.is_dir()):  # of a folder the system says so
        raise FileError(f"{path} is no file, and nothing can take its place; give another name")
    path.parent.mkdir(parents=True, exist_ok=True)
    mine = False
    try:
        with temporary.open("xb") as file:  # a file of its own, not one that stands there, nor where a link leads
            mine = True
            yield file
            # What is not on the disk when it is renamed may be an empty file after a power cut.
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
        if hasattr(os, "O_DIRECTORY"):  # the name lasts through a power cut, too, where the system can have it so
            descriptor = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
    except BaseException as error:
        if mine:
            temporary.unlink(missing_ok=True)
        # A full disk does not say whose file found no room.
        if isinstance(error, OSError) and error.filename in (None, str(temporary)):
            error.filename = str(path)
        raise


def remove_leftovers(folder: Path) -> None:
    """Remove what writers that were killed have left in a folder in which nobody writes now."""
    for path in folder.glob(f".{'[0-9a-f]' * 16}.tmp"):
        path.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file whole, in UTF-8."""
    with replace_file(path) as file:
        file.write(text.encode("utf-8"))


def write_json(path: str | Path, record: Mapping[str, Any], indent: int = 2, finite: bool = True) -> None:
    """Write a record whole, as JSON.

    Args:
        path: The file.
        record: Keys and values.
        indent: Blanks before each level.
        finite: Refuse numbers that are not finite, for which JSON has no word.

    Raises:
        ValueError: A number is not finite, where all are to be.
    """
    write_text(path, json.dumps(record, indent=indent, allow_nan=not finite) + "\n")


def add_to_json(path: Path, key: str, value: Any) -> None:
    """Put a key into a JSON file that is there, and leave all else of it, and the time at which it was written.

    Others tell by that time what was made after it, as evaluations of the run that it ended.

    Raises:
        DamagedFileError: It holds no keys and values.
        ValueError: A number is not finite.
    """
    record, before = read_json(path), path.stat()
    write_json(path, {**record, key: value})
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def write_csv(path: Path, header: Sequence[str], rows: Sequence[Sequence[float | None]]) -> None:
    """Write a table of numbers whole; empty cells stand for None, and for what is no number."""
    text = StringIO(newline="")
    csv.writer(text).writerow(header)
    csv.writer(text).writerows(["" if v is None or v != v else f"{v:.9g}" for v in row] for row in rows)
    write_text(path, text.getvalue())


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep a folder from all others that lock it; the lock ends with the process, however that ends.

    Without POSIX locks two processes in one folder are the user's affair.

    Args:
        folder: The folder; made if missing.

    Raises:
        ValueError: Another process has it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        import fcntl
    except ImportError:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(f"another process works in {folder}; wait for its end, or give another folder") from None
        yield
    finally:
        os.close(descriptor)


def file_name(name: object, what: str) -> str:
    """Return a name that is to be a file's or a folder's, if it can lead nowhere else.

    Args:
        name: The name.
        what: What it names, for the message.

    Raises:
        ValueError: It is not one plain component of a path.
    """
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w.,=+ -]*", name) or len(name) > LONGEST:
        raise ValueError(
            f"{what} '{escape_markdown(str(name)[:LONGEST])}' is no file name; allowed are letters, digits, '_' and, "
            f"after the first, '.,=+-' and spaces, {LONGEST} at most: choose another name"
        )
    return name


def output_folder(run: Path, name: str, choice: str | None = None) -> Path:
    """Return where a command writes: the folder that was chosen, or one in the run folder, or beside the file.

    Args:
        run: Run folder, or a file in it.
        name: Name of the command's folder there.
        choice: The folder, if the user chose one; it may itself be a link.

    Raises:
        LinkError: It holds a link, or is one that lies in the run folder.
    """
    folder = Path(choice) if choice is not None else (run if run.is_dir() else run.parent) / name
    if choice is None and folder.is_symlink():
        raise LinkError(folder)
    refuse_links(folder)
    return folder


def refuse_links(folder: Path) -> None:
    """Make sure that what is written into a folder, which may itself be a link, stays in it.

    Raises:
        LinkError: The folder holds a link.
    """
    if links := sorted(path for path in folder.rglob("*") if path.is_symlink()):
        raise LinkError(links[0])


def escape_markdown(words: str) -> str:
    """Return text that Markdown takes neither for HTML nor for a link, and that stays on its line."""
    line = re.sub(r"\s*[\x00-\x08\x0a-\x1f\x7f\x85\u2028\u2029]+\s*", " ", words)
    # HTML needs a letter, '/', '!' or '?' behind '<', a link '(' or '[' behind ']', and where a link leads is told by a
    # line that begins with '[': elsewhere they stand as they are.
    return re.sub(r"\](?=[(\[])", r"]\\", re.sub(r"<(?=[A-Za-z/!?])", "&lt;", re.sub(r"^\s*\[", r"\\[", line)))
