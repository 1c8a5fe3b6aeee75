"""What a setting may ask for: memory and a device that are there, and counts that end within a life."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

if TYPE_CHECKING:
    import torch

Count = Annotated[int, Field(ge=0, le=1_000_000)]
"""A number of repetitions; the limit is arbitrary, but more would hardly end."""
Positive = Annotated[int, Field(ge=1, le=1_000_000)]
"""The same, of at least one."""


def memory() -> float:
    """Return the memory that this process may have [bytes], infinity where the system does not say.

    It is the physical memory of this computer, or less where the user set a limit (`ulimit -v`).
    """
    found = float("inf")
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        found = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    with suppress(ImportError):  # no POSIX system
        import resource

        soft, _ = resource.getrlimit(resource.RLIMIT_AS)
        if soft != resource.RLIM_INFINITY:
            found = min(found, float(soft))
    return found


def check_memory(size: float, what: str) -> None:
    """Refuse what does not fit into memory, before any of it is allocated.

    Args:
        size: What would be allocated [bytes].
        what: The settings that ask for it, their values, and what they ask for.

    Raises:
        ValueError: It is more than this process may have.
    """
    if size > memory():
        raise ValueError(f"{what} would take {size / 1e9:.3g} GB of {memory() / 1e9:.3g} GB: lower them")


EXHAUSTED = re.compile(
    r"can't allocate memory|cannot allocate memory|out of memory|bad_alloc|failed to map segment", re.IGNORECASE
)
"""What torch, C++ and the loader of libraries say where memory runs out."""


def memory_wanted(error: BaseException) -> str | None:
    """Return how much memory was wanted in vain, as `8 GB`, by an error of Python, numpy, torch or the system.

    It is empty where the error does not say, and None of one that does not say that memory ran out.
    """
    known = isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM)
    if not known and not (isinstance(error, RuntimeError | ImportError | OSError) and EXHAUSTED.search(str(error))):
        return None
    found = re.search(r"allocate (?:(\d+) bytes|([\d.]+ [KMGTPE]i?B))", str(error))
    return (found[2] or f"{int(found[1]) / 1e9:.3g} GB") if found else ""


def raise_if_memory(error: BaseException) -> None:
    """Raise an error that says that memory ran out, which is no failure of what was tried."""
    if memory_wanted(error) is not None:
        raise error


@contextmanager
def one_thread() -> Iterator[None]:
    """Let torch compute on one thread: more of them make many small operations slower, and use up their CPU time."""
    import torch  # what is above does without

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def device(name: torch.device | str) -> torch.device:
    """Return the device of a name: `cpu`, or `cuda` where there is a GPU.

    Raises:
        ValueError: There is no such device here.
    """
    import torch

    try:
        named = torch.device(name)
    except RuntimeError:
        named = torch.device("meta")
    there = torch.cuda.device_count() if named.type == "cuda" else 0
    if named.type == "cpu" or (named.index or 0) < there:
        return named
    here = "cpu and cuda" if torch.cuda.is_available() else "cpu alone, as torch finds no GPU"
    raise ValueError(f"device={name} is not to be had; on this machine there is {here}: choose one")
