"""Sizes are compared with the memory that the system reports."""

import os

import pytest

from dynasindy.limits import check_memory, memory


def test_the_memory_is_that_of_the_system():
    with open("/proc/meminfo") as file:
        kilobytes = int(file.readline().split()[1])
    assert memory() == pytest.approx(1024 * kilobytes, rel=0.01)


def test_what_fits_is_allowed_and_a_byte_more_is_not():
    held = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    check_memory(held, "rows=3")
    with pytest.raises(ValueError, match="rows=3"):
        check_memory(held + 1, "rows=3")
