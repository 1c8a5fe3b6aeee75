"""What a setting may ask for: memory and a device that are there, and counts that end within a life."""

from __future__ import annotations

import os
from typing import Annotated

import torch

Count = Annotated[int, range(1_000_001), "the limit is arbitrary: more would hardly end"]
"""A number of repetitions; configs are held to the limit, callers from Python are not."""


def memory() -> float:
    """Return the physical memory of this computer [bytes], infinity where it does not say."""
    if not hasattr(os, "sysconf") or "SC_PHYS_PAGES" not in os.sysconf_names:
        return float("inf")
    return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))


def check_memory(size: float, what: str) -> None:
    """Refuse what does not fit into memory, before any of it is allocated.

    Args:
        size: What would be allocated [bytes].
        what: The settings that ask for it, their values, and what they ask for.

    Raises:
        ValueError: It is more than the physical memory.
    """
    if size > memory():
        raise ValueError(
            f"{what} would take {size / 1e9:.3g} GB; allowed is what the memory of this computer holds, "
            f"{memory() / 1e9:.3g} GB: lower them"
        )


def device(name: torch.device | str) -> torch.device:
    """Return the device of a name: `cpu`, or `cuda` where there is a GPU.

    Raises:
        ValueError: There is no such device here.
    """
    try:
        named = torch.device(name)
    except RuntimeError:
        named = torch.device("meta")
    there = torch.cuda.device_count() if named.type == "cuda" else 0
    if named.type == "cpu" or (named.index or 0) < there:
        return named
    here = "cpu and cuda" if torch.cuda.is_available() else "cpu alone, as torch finds no GPU"
    raise ValueError(f"device={name} is not to be had; on this machine there is {here}: choose one")
