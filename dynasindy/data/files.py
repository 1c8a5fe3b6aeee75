"""Files of many programs as one table: text in any dialect, MATLAB, spreadsheets, and containers of channels.

Each reader returns the columns below their headings, numbers or text, and the place of each row in the file.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dynasindy.data.headings import UNITS
from dynasindy.findings import Finding, note
from dynasindy.sentences import setting

SAMPLE = 400
"""Lines from which separator, headings and decimal sign are told."""
WIDEST = 100_000
"""Letters of such a line that are looked at."""
CUT_OFF = 5
"""Lines in which headings are looked for where values stand above them."""
MOST = 1000
"""Columns that are read."""
BLANKS = r"\s+"
SEPARATORS = (",", ";", "\t", "|", BLANKS)
"""What may stand between the values of a line; the first of several that do."""
WORD = re.compile(r"[^\s\[(]+(?:\s*(?:\[[^\]]*\]|\([^)]*\)))?")
"""A heading between blanks, with its unit."""
NUMBER = re.compile(r"[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eEdD][+-]?\d+)?|[+-]?(?:nan|inf(?:inity)?)", re.IGNORECASE)
PLAIN = str.maketrans({"\u2212": "-", "\u066b": ".", **dict.fromkeys("'\u2019\u00a0\u202f\u2009")})
"""Signs of numbers that Python does not read: another minus or decimal sign, and what parts thousands."""
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:\.\d{3})+(?:,\d*)?")
"""A number whose points part thousands, where all points of a file with decimal commas do."""
MEASURED = re.compile(r"([+-]?[\d.,]+(?:[eE][+-]?\d+)?)(?:\s+|(?![mkun]$))([^\d\s.,+-]\S*)")
"""A number with a unit, which alone and without a blank may be a milli or a kilo."""
DATE = re.compile(r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}(?:[T ].*)?")
LOST = frozenset(("nan", "-nan", "n/a", "#n/a", "na", "<na>", "null", "none", "#na", "nil"))
"""Words for a value that was not measured."""
PLACES = 9
"""Decimals of times that are compared."""
EXTRA = "pip install 'dynasindy[logs]'"


@dataclass(frozen=True)
class RawTable:
    """Columns of a file as they are in it.

    Attributes:
        headings: One for each column.
        frame: The columns, named 0, 1, ...; numbers where all cells are numbers, otherwise text.
        lines: Line or row of each row in the file, `(rows,)`.
        findings: What was left out or is not in the file.
    """

    headings: tuple[str, ...]
    frame: pd.DataFrame
    lines: NDArray[np.int64]
    findings: tuple[Finding, ...] = ()


def read_file(path: Path) -> RawTable:
    """Read a file by its ending; text where it is no other format.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is no table, or is of a format whose package is not installed.
    """
    if not path.is_file():
        key = setting("data.path")
        raise FileNotFoundError(f"{path} does not exist or is no file; allowed is the file of a log: correct {key}")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        return _read_text(path)
    try:
        return reader(path)
    except ImportError as error:
        name = (error.name or str(error)).partition(".")[0]
        raise ValueError(f"{path} needs the package {name}, which is not installed; install it: {EXTRA}") from error
    except MemoryError:
        raise
    except Exception as error:  # of some library, about a file that is damaged or none of its format
        if isinstance(error, ValueError | OSError) and str(path) in str(error):
            raise
        raise ValueError(
            f"{path} cannot be read as {path.suffix} ({' '.join(str(error).split())[:200]}); allowed is a whole file "
            "of this format: export the log again, or as CSV"
        ) from error


def _is_number(text: str) -> bool:
    """Tell whether a text is a number, with a point or a comma for decimals."""
    text = text.translate(PLAIN).strip()
    return bool(NUMBER.fullmatch(text) or THOUSANDS.fullmatch(text))


@dataclass(frozen=True)
class _Layout:
    """How a text file is laid out."""

    separator: str
    decimal: str
    headings: tuple[str, ...]
    columns: int
    first: int  # lines before the first one of values
    findings: tuple[Finding, ...] = ()
    thousands: str = ""


def _read_text(path: Path) -> RawTable:
    encoding = _encoding(path)
    with path.open(encoding=encoding, errors="replace") as file:
        if re.match(r"\s*(?:[{<]|\[\s*[\[{])", file.read(WIDEST)):
            raise ValueError(f"{path} is JSON or markup and no table; allowed are columns: write the log as CSV")
        file.seek(0)
        sample, plain = list[str](), 0
        while plain < SAMPLE and (line := file.readline()):
            sample.append(line.rstrip("\n")[:WIDEST])
            plain += not re.match(r"\s*[#%]", line)
        layout = _layout(path, sample)
    settings: dict[str, Any] = {
        "sep": layout.separator,
        "decimal": layout.decimal,
        "encoding": encoding,
        "encoding_errors": "replace",
        "header": None,
        "skiprows": layout.first,
        "skip_blank_lines": False,
        "skipinitialspace": True,
        "low_memory": False,
        "thousands": layout.thousands or None,
    }
    try:
        frame = pd.read_csv(path, names=range(layout.columns), index_col=False, **settings)
    except pd.errors.EmptyDataError:
        frame = pd.DataFrame({k: pd.Series(dtype=float) for k in range(layout.columns)})
    except pd.errors.ParserError as error:
        if found := re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error)):
            raise ValueError(_too_wide(path, found[2], found[3], layout)) from error
        why = f"{path}: {' '.join(str(error).split())}; allowed are short values: look for an open quote"
        raise ValueError(_open_quote(path) or why) from error
    lines_of = layout.first + 1 + np.arange(len(frame))
    if fault := _open_quote(path, layout.first + len(frame)):
        raise ValueError(fault)
    blank = frame[0].isna().to_numpy()
    if blank.any() and (blank := frame.isna().all(axis=1).to_numpy()).any():
        frame, lines_of = frame[~blank].reset_index(drop=True), lines_of[~blank]
    beyond = frame.iloc[:, len(layout.headings) :].notna().any(axis=1).to_numpy()
    if beyond.any():
        row = int(beyond.argmax())
        raise ValueError(_too_wide(path, lines_of[row], int(frame.loc[row].last_valid_index()) + 1, layout))
    return RawTable(layout.headings, frame.iloc[:, : len(layout.headings)], lines_of, layout.findings)


def _too_wide(path: Path, line: object, count: object, layout: _Layout) -> str:
    return (
        f"{path}, line {line} has {count} values for {len(layout.headings)} headings; allowed is one each: mend the "
        "line; where all are so, put points into decimals, or semicolons between columns"
    )


def _encoding(path: Path) -> str:
    with path.open("rb") as file:
        begin = file.read(4096)
    if begin.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\0" in begin:
        raise ValueError(
            f"{path} is not text; allowed is a CSV file with a line of headings: export the log as CSV, or give the "
            f"file the ending of its format ({', '.join(READERS)})"
        )
    try:
        begin[: begin.rfind(b"\n") + 1 or None].decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"  # a degree sign in a heading is one byte where Windows wrote it, which is no UTF-8
    return "utf-8-sig"


def _fields(line: str, separator: str) -> list[str]:
    if separator == BLANKS:
        return line.split()
    return [field.strip() for field in next(csv.reader([line], delimiter=separator), [])]


def _is_value(text: str) -> bool:
    measured = MEASURED.fullmatch(text)
    return (
        _is_number(measured[1] if measured and measured[2].lower() in UNITS else text)
        or text.strip().lower() in LOST
        or bool(DATE.fullmatch(text.strip()))
    )


def _are_units(row: Sequence[str], above: Sequence[str]) -> bool:
    """Tell whether a row holds the units of the headings above it: all in brackets, or half of them known."""
    words = [text for text in row if text]
    if not words or len(row) != len(above) or any(unit and not name for unit, name in zip(row, above, strict=True)):
        return False
    if all(re.fullmatch(r"\[[^\]]*\]|\([^)]*\)", text) for text in words):
        return True
    return 2 * sum(text.strip("[]()").lower() in UNITS for text in words) >= len(words)


def _layout(path: Path, lines: Sequence[str]) -> _Layout:
    """Find values from below, then the headings above them; what stands above these is a title."""
    lines = [re.sub(r"^\s*[#%]+\s*", "", line.removeprefix("\ufeff")) for line in lines]
    filled = [k for k, line in enumerate(lines) if line.strip(" ,;\t")]
    if not filled:
        raise ValueError(f"{path} is empty; allowed is a log with a line of headings")
    separator = _separator([lines[k] for k in filled])
    rows = {k: _fields(lines[k], separator) for k in filled}
    lower = filled[len(filled) // 2 :]
    width = max(map(len, (rows[k] for k in lower)))
    common = Counter(len(rows[k]) for k in lower).most_common(1)[0][0]
    if common > MOST:
        raise ValueError(
            f"{path} has {common} values in a line; allowed are {MOST}, one a signal: exchange rows and columns"
        )
    counts = Counter(place for k in lower for place, text in enumerate(rows[k]) if _is_value(text))
    numeric = {place for place, count in counts.items() if 2 * count >= len(lower)}
    leading = min(numeric, default=0)

    def holds_values(k: int, whole: bool = False) -> bool:
        cells = {place: rows[k][place] for place in numeric if place < len(rows[k]) and rows[k][place]}
        words = [place for place, text in cells.items() if not _is_value(text)]
        if not cells or leading in words or len(rows[k]) > common + 1:
            return False
        return not words and 4 * len(cells) >= 3 * len(numeric) if whole else len(words) < len(cells)

    first = len(filled)
    while first and (holds_values(filled[first - 1]) or (first > 1 and holds_values(filled[first - 2], True))):
        first -= 1
    if not first:  # what was cut off may stand above the headings
        words = (_differ(rows[k], common) and not any(map(_is_value, rows[k])) for k in filled[:CUT_OFF])
        first = next((place + 1 for place, head in enumerate(words) if head), 0)
    if first == len(filled):  # no values at all
        first = 1
    head, headed = filled[:first], bool(first)
    decimal = "," if separator != "," and any(re.search(r"\d,\d", lines[k]) for k in filled[first:]) else "."
    pointed = [text for k in filled[first:] for text in rows[k] if "." in text and _is_number(text.replace(".", ""))]
    thousands = "." if decimal == "," and pointed and all(map(THOUSANDS.fullmatch, pointed)) else ""
    if not headed:
        width = max(map(len, rows.values()))
        trailing = not any(len(row) == width and row[-1] for row in rows.values())
        count = width - trailing
        names = ("time", *(f"x{k}" for k in range(1, count - 1)), "u")[:count]
        said = (note("log.no_headings", names=names),)
        return _Layout(separator, decimal, names, width, filled[0], said, thousands)
    cells = {k: WORD.findall(lines[k]) if separator == BLANKS and len(rows[k]) > common else rows[k] for k in head}
    place = len(head) - 1
    while place and (not _differ(cells[head[place]], common) or _are_units(cells[head[place]], cells[head[place - 1]])):
        place -= 1  # a line such as `Smp, Smp, Smp` is none of headings
    if not _differ(cells[head[place]], common):
        place = len(head) - 1
    headings = cells[head[place]]
    others = (cells[k] for k in (*reversed(head[place + 1 :]), *head[:place][-1:]))
    if units := next((row for row in others if _are_units(row, headings)), []):
        bare = [re.sub(r"^[\[(]?-?[\])]?$|^[\[(]|[\])]$", "", unit) for unit in units]
        headings = [_with_unit(*pair) for pair in zip(headings, bare, strict=True)]
    width = max(width, len(headings))
    last = filled[first] if first < len(filled) else head[-1] + 1
    above = (note("log.title_lines", count=head[place]),) if head[place] else ()
    return _Layout(separator, decimal, tuple(headings), width, last, above, thousands)


def _differ(row: Sequence[str], common: int) -> bool:
    """Tell whether a row is as wide as the values and holds no word twice, as headings do."""
    words = [text for text in row if text]
    return len(row) >= common - 1 and len(words) > 1 and len(set(words)) == len(words)


def _separator(lines: Sequence[str]) -> str:
    """Return the separator that gives most lines of the lower half the same number of fields that are values."""

    def score(separator: str) -> float:
        lower = [_fields(line, separator) for line in lines[len(lines) // 2 :]]
        width, same = Counter(map(len, lower)).most_common(1)[0]
        fields = [text for row in lower for text in row]
        values = sum(_is_value(text) or not text for text in fields) / max(1, len(fields))
        return values * same / len(lower) if width > 1 else 0.0

    found = {separator: score(separator) for separator in SEPARATORS}
    best = max(found.values())
    if not best:
        return max(SEPARATORS[:3], key=lambda separator: lines[0].count(separator))
    # "1,5;2,5" has values between commas as well, fewer of them whole; ";" then wins by its even count.
    near = [separator for separator in SEPARATORS if found[separator] > best - 0.02]
    if "," in near and any(other in near for other in (";", "\t")):
        near.remove(",")
    return near[0]


def _open_quote(path: Path, read: int = 0) -> str:
    """Return at which line a quote opens that is not closed there, '' if as many lines were read as there are."""
    line = lines = 0
    with path.open("rb") as file:
        if not any(b'"' in part for part in iter(lambda: file.read(1 << 20), b"")):
            return ""
        file.seek(0)
        for lines, text in enumerate(file, 1):
            line = line or lines * (text.count(b'"') % 2)
    if not line or lines == read:
        return ""
    return f"{path}, line {line}: a quote opens that is not closed in its line; close or remove it"


def _of_columns(columns: Mapping[str, Any], path: Path) -> RawTable:
    """Return the arrays of one length, the commonest, as a table; a matrix has a column for each of its columns."""
    flat = {
        name: np.asarray(values)
        for key, whole in columns.items()
        for name, values in _columns_of(str(key), np.asarray(whole))
        if np.asarray(values).dtype.kind in "biufM"
    }
    lengths = Counter(len(values) for values in flat.values() if len(values) > 1)
    if not lengths:
        raise ValueError(f"{path} holds no arrays of numbers; allowed are variables of one length: save the log so")
    length = max(lengths, key=lambda size: (lengths[size], size))
    near = {name: _as_number(values) for name, values in flat.items() if abs(len(values) - length) <= 1 < len(values)}
    kept = {name: np.append(values, np.nan)[:length] for name, values in near.items()}
    other = [f"{name} ({len(values)})" for name, values in flat.items() if name not in kept and len(values) > 1]
    out = (note("log.other_lengths", length=length, names=other),) if other else ()
    return RawTable(tuple(kept), pd.DataFrame(dict(enumerate(kept.values()))), 1 + np.arange(length), findings=out)


def _as_number(values: NDArray[Any]) -> NDArray[np.float64]:
    if values.dtype.kind in "Mm":
        return np.where(np.isnat(values), np.nan, values.astype(f"{values.dtype.kind}8[ns]").astype(np.int64) / 1e9)
    return values.astype(np.float64)


def _columns_of(name: str, values: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    values = values.squeeze() if values.ndim != 1 else values
    if values.ndim == 1:
        yield name, values
    elif values.ndim == 2:
        tall = values if len(values) >= values.shape[1] else values.T
        yield from ((f"{name}[{k}]", tall[:, k]) for k in range(tall.shape[1]))


def _flatten(tree: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the arrays of nested structures, with their names; Simulink's signals have the names of their labels."""
    if isinstance(tree, Mapping):
        label = tree.get("label")
        for key, value in tree.items():
            if str(key).startswith("__") or key in ("label", "dimensions", "blockName", "title", "plotStyle"):
                continue
            inner = key in ("signals", "values", "Data", "data")
            own = str(label) if inner and isinstance(label, str) and label else ""
            time = str(key).lower() == "time"
            yield from _flatten(value, own or ("time" if time else name if inner and name else str(key)))
    elif isinstance(tree, list | tuple) and tree and isinstance(tree[0], Mapping):
        for k, value in enumerate(tree):
            yield from _flatten(value, f"{name}[{k}]")
    elif isinstance(tree, np.ndarray) and tree.dtype == object:
        for k, value in enumerate(tree.ravel()):
            yield from _flatten(value, f"{name}[{k}]")
    else:
        yield name, np.asarray(tree)


def _put(columns: dict[str, Any], name: str, values: Any) -> None:
    """Add a column; one of a name that is taken gets a number, unless it is the same time once more."""
    if name == "time" and name in columns:
        return
    columns[name if name not in columns else f"{name}_{sum(key.startswith(name) for key in columns) + 1}"] = values


def _read_mat(path: Path) -> RawTable:
    from scipy.io import loadmat

    with path.open("rb") as file:
        newer = b"MATLAB 7.3" in file.read(128)
    if newer:
        return _read_hdf5(path)
    columns: dict[str, Any] = {}
    for name, values in _flatten(loadmat(str(path), simplify_cells=True)):
        _put(columns, "time" if name == "tout" else name, values)
    return _of_columns(columns, path)


def _read_hdf5(path: Path) -> RawTable:
    h5py = import_module("h5py")
    columns: dict[str, Any] = {}
    with h5py.File(path, "r") as file:

        def keep(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset) and item.dtype.kind in "biufV" and "#refs#" not in name:
                short = _with_unit(name.rpartition("/")[2], item.attrs.get("unit", item.attrs.get("units", "")))
                parts = {field: item[field] for field in item.dtype.names or ()}
                columns.update(parts or {name if short in columns else short: item[()]})

        file.visititems(keep)
    return _of_columns(columns, path)


def _with_unit(name: str, unit: object) -> str:
    """Return a heading of a name and the unit that a container has of it, if any."""
    return f"{name} [{unit}]" if isinstance(unit, str) and unit else name


def _read_npz(path: Path) -> RawTable:
    file = np.load(path, allow_pickle=False)
    if isinstance(file, np.ndarray):
        fields = file.dtype.names
        return _of_columns({name: file[name] for name in fields} if fields else {"data": file}, path)
    with file:
        return _of_columns(dict(file), path)


def _of_frame(frame: pd.DataFrame) -> RawTable:
    if frame.index.name or not isinstance(frame.index, pd.RangeIndex):
        frame = frame.reset_index(names=frame.index.name or ("time" if frame.index.dtype.kind in "Mm" else "index"))
    headings = tuple(str(name) for name in frame.columns)
    kinds = {k: frame.iloc[:, k].dtype.kind for k in range(len(headings))}
    columns = {
        k: pd.Series(_as_number(frame.iloc[:, k].to_numpy(f"{kind}8[ns]"))) if kind in "Mm" else frame.iloc[:, k]
        for k, kind in kinds.items()
    }
    return RawTable(headings, pd.DataFrame(columns), np.arange(1, len(frame) + 1, dtype=np.int64))


def _read_excel(path: Path) -> RawTable:
    """Read the largest sheet as text would be: headings may stand below a title."""
    sheets = pd.read_excel(path, header=None, sheet_name=None)
    sheet = max(sheets, key=lambda name: sheets[name].size)
    said = (
        (note("log.sheet", sheet=sheet, others=[name for name in sheets if name != sheet]),) if len(sheets) > 1 else ()
    )
    cells = sheets[sheet].replace(r"\s*[\r\n]+\s*", " ", regex=True)
    buffer = io.StringIO()
    cells.to_csv(buffer, header=False, index=False)
    lines = buffer.getvalue().splitlines()
    layout = _layout(path, lines[:SAMPLE])
    body = cells.iloc[layout.first :, : len(layout.headings)]
    body.columns = pd.RangeIndex(body.shape[1])
    frame = body.reset_index(drop=True).infer_objects()
    return RawTable(layout.headings, frame, layout.first + 1 + np.arange(len(frame)), (*said, *layout.findings))


def _read_tdms(path: Path) -> RawTable:
    file = import_module("nptdms").TdmsFile.read(path)
    columns: dict[str, Any] = {}
    waves: dict[str, pd.Series] = {}
    for group in file.groups():
        for channel in group.channels():
            name = _with_unit(channel.name, channel.properties.get("unit_string"))
            name = name if name not in {**columns, **waves} else f"{group.name}_{name}"
            if "wf_increment" in channel.properties:
                waves[name] = pd.Series(channel[:], channel.time_track().round(PLACES))
            else:
                _put(columns, name, channel[:])
    if columns or not waves:
        lengths = {len(wave): wave.index.to_numpy() for wave in waves.values()}
        times = {"time": lengths[max(lengths)]} if lengths else {}
        return _of_columns(times | columns | {name: wave.to_numpy() for name, wave in waves.items()}, path)
    return _of_frame(pd.concat(waves, axis=1).sort_index().rename_axis("time"))


def _read_mdf(path: Path) -> RawTable:
    with import_module("asammdf").MDF(path) as file:
        units = {channel.name: channel.unit for group in file.groups for channel in group.channels}
        frame = file.to_dataframe(use_interpolation=False, time_from_zero=False)
    return _of_frame(frame.rename(columns=lambda name: _with_unit(name, units.get(name))).rename_axis("time"))


def _read_bag(path: Path) -> RawTable:
    """Read the numbers of all messages: a column each, a row for each time, empty where a topic says nothing."""
    rosbags, highlevel = import_module("rosbags.typesys"), import_module("rosbags.highlevel")
    store = rosbags.get_typestore(rosbags.Stores.LATEST)
    rows: dict[int, dict[str, float]] = {}
    with highlevel.AnyReader([path], default_typestore=store) as reader:
        for connection, stamp, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            row = rows.setdefault(stamp, {})
            row.update(_message_values(connection.topic, message))
    frame = pd.DataFrame.from_dict(rows, orient="index").sort_index()
    frame.index = pd.Index(frame.index / 1e9, name="time")
    return _of_frame(frame)


def _message_values(name: str, message: Any) -> Iterator[tuple[str, float]]:
    if isinstance(message, bool | int | float | np.number):
        yield name, float(message)
    elif isinstance(message, np.ndarray | list | tuple):
        yield from (pair for k, value in enumerate(message) for pair in _message_values(f"{name}[{k}]", value))
    elif hasattr(message, "__dataclass_fields__"):
        for field in message.__dataclass_fields__:
            if field not in ("header", "layout", "__msgtype__"):
                inner = name if field == "data" else f"{name}/{field}"
                yield from _message_values(inner, getattr(message, field))


READERS: dict[str, Callable[[Path], RawTable]] = {
    ".mat": _read_mat,
    ".h5": _read_hdf5,
    ".hdf5": _read_hdf5,
    ".npz": _read_npz,
    ".npy": _read_npz,
    ".parquet": lambda path: _of_frame(pd.read_parquet(path)),
    ".feather": lambda path: _of_frame(pd.read_feather(path)),
    ".xlsx": _read_excel,
    ".tdms": _read_tdms,
    ".mf4": _read_mdf,
    ".mdf": _read_mdf,
    ".bag": _read_bag,
    ".mcap": _read_bag,
    ".db3": _read_bag,
}
"""Formats by the ending of a file; all others are text."""
