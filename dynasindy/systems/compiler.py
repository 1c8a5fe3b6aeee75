"""The C compiler of this computer: C text in, a shared library out."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from importlib import resources
from pathlib import Path

from torch import Tensor

from dynasindy.safe_io import replace_file

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
"""Under these settings what is written here compiles."""
FAITHFUL = ("-O2", "-fno-math-errno", "-ffp-contract=off", "-std=c99")
"""Operation by operation, as it is written."""
FAST = ("-O2", "-ftree-vectorize", "-ffast-math", "-fno-finite-math-only", "-fno-associative-math", "-std=c99")
"""Several rows by one instruction. What is not finite stays so, and a difference of numbers that are almost equal is
taken as it is written."""
KEPT = 200
"""Libraries that stay in the user's cache, those that were made or loaded last."""
LONGEST = 300
"""Time after which a compiler is taken to hang [s]."""
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
"""How the name of a shared library ends."""


def compiler() -> str | None:
    """Return the C compiler: the environment's CC, or cc, gcc or clang; None if there is none."""
    names = [os.environ.get("CC", ""), "cc", "gcc", "clang"]
    return next((path for path in map(shutil.which, filter(None, names)) if path), None)


def compile_library(sources: Sequence[Path], library: Path, options: Sequence[str] = ("-O2", *STRICT)) -> Path:
    """Compile C sources to a shared library.

    Args:
        sources: Files of C.
        library: File to write.
        options: Settings of the compiler.

    Raises:
        FileNotFoundError: There is no compiler.
        ValueError: The compiler refuses the sources.
    """
    library.parent.mkdir(parents=True, exist_ok=True)
    return _run([*options, "-fPIC", "-shared", *map(str, sources), "-o", str(library), "-lm"], sources[0], library)


def _build_fast(source: Path, library: Path) -> Path:
    """Compile a C source for this computer's processor, and return the library."""
    # Linked with fast arithmetic, a library would have the whole process take small numbers as zero.
    compiled = source.with_suffix(".o")
    plain = [*FAST, "-fPIC", "-c", str(source), "-o", str(compiled)]
    try:
        _run(["-march=native", *plain], source, compiled)
    except ValueError:  # not every compiler knows its own processor
        _run(plain, source, compiled)
    return _run(["-shared", str(compiled), "-o", str(library), "-lm"], source, library)


@cache
def load_library(source: str, *, fast: bool) -> ctypes.CDLL:
    """Compile a C text, once on this computer: the library stays in the user's cache.

    Args:
        source: The text.
        fast: Arithmetic for many numbers at once, in place of operation by operation as it is written.

    Raises:
        FileNotFoundError: There is no compiler.
        ValueError: The compiler refuses the text.
        OSError: What the compiler wrote cannot be loaded.
    """
    file = _cache_file(source, fast)
    if file is not None:
        with suppress(OSError):  # it may be missing or damaged, and is then compiled anew
            code = ctypes.CDLL(str(file))
            with suppress(OSError):  # it may be another user's
                file.touch()
            return code
    # Each call has a folder of its own, as threads may compile the same text at the same time. What is loaded needs
    # its file no more; where it cannot be removed then, as on Windows, it is left to the system.
    with tempfile.TemporaryDirectory(prefix="dynasindy_", ignore_cleanup_errors=True) as folder:
        stem = Path(folder) / hashlib.sha256(source.encode()).hexdigest()[:16]
        text, library = stem.with_suffix(".c"), stem.with_suffix(SUFFIX)
        text.write_text(source, encoding="utf-8")
        made = _build_fast(text, library) if fast else compile_library([text], library, FAITHFUL)
        code = ctypes.CDLL(str(made))
        if file is not None:
            with suppress(OSError):  # the disk may be full
                with replace_file(file) as whole:
                    whole.write(made.read_bytes())
                kept = sorted(file.parent.glob(f"*{SUFFIX}"), key=lambda path: path.stat().st_mtime, reverse=True)
                for old in kept[KEPT:]:
                    old.unlink(missing_ok=True)
    return code


def c_text(room: str, *names: str) -> str:
    """Return the C texts of a room of the package, one after another."""
    texts = (resources.files(f"dynasindy.{room}").joinpath("c", name) for name in names)
    return "\n".join(text.read_text(encoding="utf-8") for text in texts)


def addresses(*tensors: Tensor | None) -> list[ctypes.c_void_p | None]:
    """Return where tensors lie, as C reads it; nowhere for None."""
    return [None if tensor is None else ctypes.c_void_p(tensor.data_ptr()) for tensor in tensors]


def find_library(source: str, without: str, *, fast: bool = True) -> ctypes.CDLL | None:
    """Return what `load_library` does; None where there is no compiler or, with a warning, one that refuses the text.

    Args:
        source: The text.
        without: What is slower then, in words.
        fast: See `load_library`.
    """
    try:
        return load_library(source, fast=fast)
    except FileNotFoundError:
        return None
    except (ValueError, OSError) as error:
        warnings.warn(f"{without} by torch code, which is slower: {error}", stacklevel=2)
        return None


def _cache_file(source: str, fast: bool) -> Path | None:
    """Return the file of a C text's library, by compiler and processor; None without a folder of the user's own."""
    found = compiler()
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dynasindy"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        state = folder.stat()
        if found is None or (hasattr(os, "getuid") and (state.st_uid != os.getuid() or state.st_mode & 0o022)):
            return None
        processor, about = [platform.machine(), platform.processor()], Path("/proc/cpuinfo")
        if about.is_file():
            lines = about.read_text(errors="replace").partition("\n\n")[0].splitlines()
            processor += [line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))]
        facts = [source, str(fast), *FAST, *FAITHFUL, found, str(Path(found).stat().st_mtime_ns), *processor]
    except (OSError, RuntimeError):  # no home
        return None
    return folder / f"{hashlib.sha256(repr(facts).encode()).hexdigest()[:32]}{SUFFIX}"


def _run(arguments: Sequence[str], source: Path, made: Path) -> Path:
    if (found := compiler()) is None:
        raise FileNotFoundError("no C compiler was found; install gcc or clang, or do without machine code")
    command = [found, *arguments]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", timeout=LONGEST
        )
    except subprocess.TimeoutExpired as error:
        raise ValueError(f"the C compiler {found} took more than {LONGEST} s over {source.name}") from error
    if done.returncode:
        said = " ".join(done.stderr.split())[:300] or f"it ended with code {done.returncode}"
        raise ValueError(f"the C compiler refused {source.name}: {said}")
    return made
