"""Files of many programs as one table: text in any dialect, MATLAB, spreadsheets, and containers of channels.

Each reader returns the columns by their headings, numbers or text, the line or row of each in the file as their index,
and what was left out.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dynasindy.data.headings import UNITS
from dynasindy.findings import Finding, note
from dynasindy.sentences import setting

SAMPLE, WIDEST, MOST = 400, 100_000, 1000
"""Lines from which the layout is told, letters of such a line that are looked at, and columns that are read."""
BLANKS = r"\s+"
SEPARATORS = (",", ";", "\t", "|", BLANKS)
"""What may stand between the values of a line; the first of several that do."""
WORD = re.compile(r"[^\s\[(]+(?:\s*(?:\[[^\]]*\]|\([^)]*\)))?")
"""A heading between blanks, with its unit."""
NUMBER = re.compile(r"[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?|[+-]?(?:nan|inf(?:inity)?)", re.IGNORECASE)
DATE = re.compile(r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}(?:[T ].*)?")
LOST = frozenset(("nan", "-nan", "n/a", "#n/a", "na", "<na>", "null", "none"))
"""Words for a value that was not measured."""
Raw = tuple[pd.DataFrame, list[Finding]]


def read_file(path: Path) -> Raw:
    """Read a file by its ending; text where it is no other format.

    Returns:
        The columns, numbers or text, below their headings; the index holds the line or row of each in the file. Beside
        them stands what was left out or is not in the file.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is no table, or is of a format whose package is not installed.
    """
    if not path.is_file():
        key = setting("data.path")
        raise FileNotFoundError(f"{path} does not exist or is no file; allowed is the file of a log: correct {key}")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        with path.open(encoding=_encoding(path), errors="replace", newline="") as file:
            return _read_text(path, file)
    try:
        return reader(path)
    except ImportError as error:
        name = (error.name or str(error)).partition(".")[0]
        install = "pip install 'dynasindy[logs]'"
        raise ValueError(f"{path} needs the package {name}, which is not installed; install it: {install}") from error
    except MemoryError:
        raise
    except Exception as error:  # of some library, about a file that is damaged or none of its format
        if isinstance(error, ValueError | OSError) and str(path) in str(error):
            raise
        raise ValueError(
            f"{path} cannot be read as {path.suffix} ({' '.join(str(error).split())[:200]}); allowed is a whole file "
            "of this format: export the log again, or as CSV"
        ) from error


def _read_text(path: Path, file: TextIO) -> Raw:
    if re.match(r"\s*(?:[{<]|\[\s*[\[{])", file.read(WIDEST)):
        raise ValueError(f"{path} is JSON or markup and no table; allowed are columns: write the log as CSV")
    file.seek(0)
    sample = [line.rstrip("\r\n")[:WIDEST] for line in islice(file, SAMPLE)]
    file.seek(0)
    separator, decimal, headings, width, first, findings = _layout(path, sample)
    try:
        frame = pd.read_csv(
            file,
            sep=separator,
            decimal=decimal,
            header=None,
            names=range(width),
            index_col=False,
            skiprows=first,
            skip_blank_lines=False,
            skipinitialspace=True,
            low_memory=False,
        )
    except pd.errors.EmptyDataError:
        frame = pd.DataFrame(columns=range(width), dtype=float)
    except pd.errors.ParserError as error:
        opened = re.search(r"inside string starting at row (\d+)", str(error))
        unclosed = opened and f"a quote opens in line {int(opened[1]) + 1} and never closes"
        raise _no_table(path, unclosed or str(error).partition("C error: ")[2].strip()) from error
    frame.index = pd.RangeIndex(first + 1, first + 1 + len(frame))
    for column, texts in frame.select_dtypes("str").items():
        if (broken := texts.str.contains("[\r\n]")).any():
            raise _no_table(path, f"a quote opens in line {broken.idxmax()} and does not close there")
        if decimal == ",":
            whole = texts.str.fullmatch(r"-?\d{1,3}(,\d+)?")
            grouped = texts.str.fullmatch(r"-?[1-9]\d{0,2}(\.\d{3})+(,\d+)?")
            both = grouped & texts.str.contains(",")  # without such a number a point may be that of decimals
            if both.any() and (whole | grouped | texts.isna()).all():
                texts = texts.str.replace(".", "", regex=False)
            frame[column] = texts.str.replace(",", ".", regex=False)
    frame = frame.dropna(how="all")
    beyond = frame.iloc[:, len(headings) :].notna().any(axis=1)
    if beyond.any():
        raise _no_table(path, f"line {beyond.idxmax()} has more values than there are headings, {len(headings)}")
    return frame.iloc[:, : len(headings)].set_axis(headings, axis=1), findings


def _no_table(path: Path, why: str) -> ValueError:
    return ValueError(
        f"{path}: {why}; allowed is a value for each heading, and quotes that close in their line: mend it; where all "
        "are so, put points into decimals, or semicolons between columns"
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
    return bool(NUMBER.fullmatch(text) or text.lower() in LOST or DATE.fullmatch(text))


def _are_units(row: Sequence[str], above: Sequence[str]) -> bool:
    """Tell whether a row holds the units of the headings above it: all in brackets, or half of them known."""
    words = [text for text in row if text]
    if not words or len(row) != len(above) or any(unit and not name for unit, name in zip(row, above, strict=True)):
        return False
    known = sum(text.strip("[]()").lower() in UNITS for text in words)
    return 2 * known >= len(words) or all(re.fullmatch(r"\[[^\]]*\]|\([^)]*\)", text) for text in words)


def _layout(path: Path, lines: Sequence[str]) -> tuple[str, str, Sequence[str], int, int, list[Finding]]:
    """Find values from below, then the headings above them; what stands above these is a title.

    Returns separator, sign of decimals, headings, columns, lines before the first one of values, and what was left out.
    """
    lines = [re.sub(r"^\s*[#%]+\s*", "", line.removeprefix("\ufeff")) for line in lines]
    filled = [k for k, line in enumerate(lines) if line.strip(" ,;\t")]
    if not filled:
        raise ValueError(f"{path} is empty; allowed is a log with a line of headings")
    separator = _separator([lines[k] for k in filled])
    rows = [_fields(lines[k], separator) for k in filled]
    lower = rows[len(rows) // 2 :]
    width = max(map(len, lower))
    common = Counter(map(len, lower)).most_common(1)[0][0]
    if common > MOST or common > max(50, 10 * len(rows)):
        raise ValueError(
            f"{path} has {common} values in a line; allowed are {MOST}, one a signal, and a line a sample: exchange "
            "rows and columns"
        )
    counts = Counter(place for row in lower for place, text in enumerate(row) if _is_value(text))
    numeric = {place for place, count in counts.items() if 2 * count >= len(lower)}

    def holds_values(row: Sequence[str], whole: bool = False) -> bool:
        cells = {place: _is_value(row[place]) for place in numeric if place < len(row) and row[place]}
        if not cells or not cells.get(min(numeric), True) or len(row) > common + 1:
            return False
        return all(cells.values()) and 4 * len(cells) >= 3 * len(numeric) if whole else any(cells.values())

    words = (k for k, row in enumerate(rows) if not (holds_values(row) or (k and holds_values(rows[k - 1], True))))
    first = max(words, default=-1) + 1
    if not first:
        raise ValueError(f"{path} has no line of headings; allowed is one above the values: write it, as time,angle,u")
    first = 1 if first == len(rows) else first  # no values at all
    again = (k for k, row in enumerate(rows[: first - 1]) if row == rows[first - 1] and holds_values(rows[k + 1], True))
    first = next(again, first - 1) + 1  # headings of a page, or of a logger that began anew, are those of the first
    commas = r"\d,\d" if separator != "," else r"^-?(0,\d+|\d+,(\d\d?|\d{4,}))$"  # in quotes, and no thousands
    cells = [text for row in rows[first:] for text in row]
    points = sum(bool(re.fullmatch(r"-?\d*\.\d+", text)) for text in cells if separator == ",")
    decimal = "," if sum(bool(re.search(commas, text)) for text in cells) > points else "."
    split = separator == BLANKS
    head = [WORD.findall(lines[k]) if split and len(row) > common else row for k, row in zip(filled, rows[:first])]
    differ = [k for k, row in enumerate(head) if _differ(row, common) and not (k and _are_units(row, head[k - 1]))]
    place = differ[-1] if differ else first - 1
    headings = head[place]  # a line such as `Smp, Smp, Smp` is none of headings
    others = (*reversed(head[place + 1 :]), *head[:place][-1:])
    units: Sequence[str] = next((row for row in others if _are_units(row, headings)), [])
    if units:
        bare = [re.sub(r"^[\[(]?-?[\])]?$|^[\[(]|[\])]$", "", unit) for unit in units]
        headings = [_with_unit(*pair) for pair in zip(headings, bare, strict=True)]
    above = [note("log.title_lines", count=filled[place])] if filled[place] else []
    last = filled[first] if first < len(filled) else filled[first - 1] + 1
    return separator, decimal, headings, max(width, len(headings)), last, above


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
    return near[1] if near[0] == "," and near[1:] and near[1] in ";\t" else near[0]


def _of_columns(tree: Mapping[str, Any], path: Path) -> Raw:
    """Return the arrays of one length, the commonest, of nested structures."""
    flat = dict[str, NDArray[Any]]()
    for name, values in _flatten(tree):
        if values.dtype.kind in "biufMmcSU" and len(values) > 1:
            _put(flat, name, values)
    lengths = Counter(len(values) for values in flat.values() if values.dtype.kind in "biufMm")
    if not lengths:
        raise ValueError(f"{path} holds no arrays of numbers; allowed are variables of one length: save the log so")
    length = max(lengths, key=lambda size: (lengths[size], size))
    kept = dict[str, pd.Series]()
    for name, values in flat.items():
        if abs(len(values) - length) <= 1 and (kind := values.dtype.kind) != "c":  # a spectrum is as long as its signal
            text = np.char.decode(values, "utf-8", "replace") if kind == "S" else values
            kept[name] = pd.Series(text if kind in "MmSU" else values.astype(np.float64))
    other = [f"{name} ({len(values)})" for name, values in flat.items() if name not in kept]
    frame = pd.DataFrame(kept).reindex(range(length)).set_axis(pd.RangeIndex(1, 1 + length))
    return frame, [note("log.other_lengths", length=length, names=other)] if other else []


def _flatten(tree: Any, name: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the columns of nested structures, with their names; Simulink's signals have the names of their labels."""
    if isinstance(tree, Mapping):
        label = tree.get("label")
        for key, value in tree.items():
            if str(key).startswith("__") or key in ("label", "dimensions", "blockName", "title", "plotStyle"):
                continue
            inner = key in ("signals", "values", "Data", "data")
            time = key == "tout" or (name and str(key).lower() == "time")
            own = "time" if time else name if inner and name else str(key)
            yield from _flatten(value, label if inner and isinstance(label, str) and label else own)
        return
    cells = tree if isinstance(tree, list | tuple) else None  # of MATLAB, which may hold anything
    values = np.asarray(tree if cells is None else 0.0)
    if cells is not None or values.dtype == object:
        for k, value in enumerate(values.ravel() if cells is None else cells):
            yield from _flatten(value, f"{name}[{k}]")
    elif values.dtype.names:
        yield from _flatten({field: values[field] for field in values.dtype.names})
    elif (values := values.squeeze() if values.ndim > 1 else values).ndim == 2:
        tall = values if len(values) >= values.shape[1] else values.T
        yield from ((f"{name}[{k}]", column) for k, column in enumerate(tall.T))
    elif values.ndim:
        yield name, values.ravel()  # of three dimensions too long for a column, and told as that


def _put(columns: dict[str, Any], name: str, values: Any) -> None:
    """Add a column; one of a name that is taken gets a number, unless it is the same time once more."""
    if name == "time" and name in columns:
        return
    columns[name if name not in columns else f"{name}_{sum(key.startswith(name) for key in columns) + 1}"] = values


def _read_mat(path: Path) -> Raw:
    from scipy.io import loadmat

    with path.open("rb") as file:
        if b"MATLAB 7.3" in file.read(128):
            return _read_hdf5(path)
    return _of_columns(loadmat(str(path), simplify_cells=True), path)


def _read_hdf5(path: Path) -> Raw:
    h5py = import_module("h5py")
    columns: dict[str, Any] = {}
    with h5py.File(path, "r") as file:

        def keep(name: str, item: Any) -> None:
            text = isinstance(item, h5py.Dataset) and h5py.check_string_dtype(item.dtype)
            if isinstance(item, h5py.Dataset) and (text or item.dtype.kind in "biufV") and "#refs#" not in name:
                short = _with_unit(name.rpartition("/")[2], item.attrs.get("unit", item.attrs.get("units", "")))
                values = np.asarray(item.asstr("utf-8", "replace")[()], str) if text else item[()]
                columns[name if short in columns else short] = values

        file.visititems(keep)
    return _of_columns(columns, path)


def _with_unit(name: str, unit: object) -> str:
    return f"{name} [{unit}]" if isinstance(unit, str) and unit else name


def _read_npz(path: Path) -> Raw:
    file = np.load(path, allow_pickle=False)
    if isinstance(file, np.ndarray):
        return _of_columns({"data": file}, path)
    with file:
        return _of_columns(dict(file), path)


def _of_frame(frame: pd.DataFrame) -> Raw:
    if frame.index.name or not isinstance(frame.index, pd.RangeIndex):
        frame = frame.reset_index(names=frame.index.name or ("time" if frame.index.dtype.kind in "Mm" else "index"))
    return frame.rename(columns=str).set_axis(pd.RangeIndex(1, 1 + len(frame))), []


def _read_excel(path: Path) -> Raw:
    """Read the largest sheet as text would be: headings may stand below a title."""
    sheets = pd.read_excel(path, header=None, sheet_name=None)
    sheet = max(sheets, key=lambda name: sheets[name].size)
    others = [name for name in sheets if name != sheet]
    text = sheets[sheet].replace(r"\s*[\r\n]+\s*", " ", regex=True).to_csv(header=False, index=False)
    frame, findings = _read_text(path, io.StringIO(text))
    return frame, [*([note("log.sheet", sheet=sheet, others=others)] if others else []), *findings]


def _read_tdms(path: Path) -> Raw:
    file = import_module("nptdms").TdmsFile.read(path)
    columns: dict[str, Any] = {}
    waves: dict[str, pd.Series] = {}
    for group in file.groups():
        for channel in group.channels():
            name = _with_unit(channel.name, channel.properties.get("unit_string"))
            name = name if name not in {**columns, **waves} else f"{group.name}_{name}"
            if "wf_increment" in channel.properties:
                waves[name] = pd.Series(channel[:], channel.time_track().round(9))
            else:
                _put(columns, name, channel[:])
    if waves and not columns:
        return _of_frame(pd.concat(waves, axis=1).sort_index().rename_axis("time"))
    longest = max(waves.values(), key=len, default=None)
    times = {} if longest is None else {"time": longest.index.to_numpy()}
    return _of_columns(times | columns | {name: wave.to_numpy() for name, wave in waves.items()}, path)


def _read_mdf(path: Path) -> Raw:
    with import_module("asammdf").MDF(path) as file:
        units = {channel.name: channel.unit for group in file.groups for channel in group.channels}
        frame = file.to_dataframe(use_interpolation=False, time_from_zero=False)
    return _of_frame(frame.rename(columns=lambda name: _with_unit(name, units.get(name))).rename_axis("time"))


def _read_bag(path: Path) -> Raw:
    """Read the numbers of all messages: a column each, a row for each time, empty where a topic says nothing."""
    rosbags, highlevel = import_module("rosbags.typesys"), import_module("rosbags.highlevel")
    store = rosbags.get_typestore(rosbags.Stores.LATEST)
    rows: dict[int, dict[str, float]] = {}
    with highlevel.AnyReader([path], default_typestore=store) as reader:
        for connection, stamp, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            rows.setdefault(stamp, {}).update(_message_values(connection.topic, message))
    frame = pd.DataFrame.from_dict(rows, orient="index").sort_index()
    return _of_frame(frame.set_axis(pd.Index(frame.index / 1e9, name="time")))


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


READERS: dict[str, Callable[[Path], Raw]] = {
    ".mat": _read_mat,
    **dict.fromkeys((".h5", ".hdf5"), _read_hdf5),
    **dict.fromkeys((".npz", ".npy"), _read_npz),
    ".parquet": lambda path: _of_frame(pd.read_parquet(path)),
    ".feather": lambda path: _of_frame(pd.read_feather(path)),
    ".xlsx": _read_excel,
    ".tdms": _read_tdms,
    **dict.fromkeys((".mf4", ".mdf"), _read_mdf),
    **dict.fromkeys((".bag", ".mcap", ".db3"), _read_bag),
}
"""Formats by the ending of a file; all others are text."""
