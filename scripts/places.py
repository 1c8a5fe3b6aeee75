"""What a command line implies: the folder of a sweep or of a resumed run, and that a model stands for a log."""

import errno
import hashlib
import os
import re
from pathlib import Path
from tempfile import TemporaryFile

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

SWEEPING = ("-m", "--multirun")


def complete(words: list[str]) -> None:
    """Add to a command line, in place, what it implies: the folder that Hydra is to use, and the plant of a model.

    The same sweep has the same folder, so that the same command goes on with it; a resumed run keeps its own. A model
    that is given without data and without a plant, `model=model.json`, stands in the place of a log's.

    Raises:
        FileNotFoundError: The folder to resume is no run folder.
    """
    given = dict(word.split("=", 1) for word in words[1:] if "=" in word)
    if given.get("model", "null") not in ("null", "") and not {"data", "system", "resume"} & set(given):
        _add(words, "system=logged")
    folder = given.get("resume", "null").strip("'\"")
    if folder not in ("null", ""):
        if not (Path(folder) / "config.yaml").is_file():
            raise FileNotFoundError(
                f"resume={folder} is no run folder, it has no config.yaml; give the folder that train.py printed"
            )
        _add(words, f"hydra.run.dir={_quoted(folder)}")
    elif any(word in SWEEPING for word in words) and "hydra.sweep.dir" not in given:
        _add(words, f"hydra.sweep.dir={_quoted('runs/' + name(words[1:]))}")


def as_text(word: str) -> str:
    """Return a word of a command line as Hydra reads it: a value or an item of a list that it cannot read is text.

    The shell takes away the quotation marks of `data.time="Time [ms]"`, and a bracket within a value is none that Hydra
    knows. What has brackets that are not closed is left as it is, to be refused.
    """
    key, sign, value = word.partition("=")
    closed = all(value.count(a) == value.count(b) for a, b in ("[]", "()", "{}"))
    if not sign or word.startswith("-") or not value or not closed or _is_read(word):
        return word
    if value[0] == "[" and value[-1] == "]":
        items = [item.strip() for item in re.split(r",(?![^\[({]*[\])}])", value[1:-1])]
        made = f"{key}=[{','.join(item if _is_read(f'{key}={item}') else _quoted(item) for item in items)}]"
    else:
        made = word if value[0] in "[{('\"" else f"{key}={_quoted(value)}"
    return made if _is_read(made) else word


def _is_read(word: str) -> bool:
    """Tell whether Hydra can read a word."""
    try:
        OverridesParser.create().parse_override(word)
    except HydraException:
        return False
    return True


def _add(words: list[str], setting: str) -> None:
    """Add a setting behind the last one: Hydra reads none that an option, as --config-dir, parts from the others."""
    given = [place for place, word in enumerate(words) if place and "=" in word and not word.startswith("-")]
    words.insert(given[-1] + 1 if given else len(words), setting)


def require_writable(path: Path) -> None:
    """Make sure, before the work that fills it, that a folder can be made and written.

    Raises:
        OSError: It cannot.
    """
    place = path.absolute()
    while not place.exists():
        place = place.parent
    if not place.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))
    try:
        with TemporaryFile(dir=place):  # permissions alone do not tell
            pass
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


def name(words: list[str]) -> str:
    """Return a name for a sweep: its settings in words, as far as they fit, and a digest of them all."""
    settings = [word for word in words if "=" in word and not word.startswith("hydra")]
    digest = hashlib.blake2b(" ".join(settings).encode(), digest_size=3).hexdigest()
    readable = re.sub(r"[^A-Za-z0-9.]+", "-", "_".join(settings).replace("=", "-")).strip("-.")
    return f"{readable[:80]}_{digest}"


def _quoted(folder: str) -> str:
    """Return a path as Hydra's grammar takes any text."""
    escaped = folder.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"
