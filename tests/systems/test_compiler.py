"""The compiler is found where it is, what it refuses costs one line, and fast code leaves the process as it was."""

import ctypes
import os

import pytest
import torch

from dynasindy.systems import compiler as module
from dynasindy.systems.compiler import SUFFIX, _build_fast, compile_library, compiler, load_library

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler on this computer")


def test_without_a_compiler_one_line_says_so(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    assert compiler() is None
    with pytest.raises(FileNotFoundError, match="clang"):
        compile_library([tmp_path / "any.c"], tmp_path / "any.so")


@needs_compiler
def test_what_the_compiler_refuses_costs_one_line(tmp_path):
    (tmp_path / "bad.c").write_text("int f(void) { return ; }}\n")
    bad, made = tmp_path / "bad.c", tmp_path / "bad.so"
    for attempt in (lambda: compile_library([bad], made), lambda: _build_fast(bad, made)):
        with pytest.raises(ValueError, match="refused") as error:
            attempt()
        assert "\n" not in str(error.value)


@needs_compiler
def test_fast_code_computes_and_leaves_small_numbers_small(tmp_path):
    (tmp_path / "half.c").write_text("float half(float v) { return v / 2; }\n")
    code = ctypes.CDLL(str(_build_fast(tmp_path / "half.c", tmp_path / f"half{SUFFIX}")))
    code.half.argtypes, code.half.restype = [ctypes.c_float], ctypes.c_float
    assert code.half(3.0) == 1.5
    # With the flush of small numbers to zero that some linkers bring along, this product would be zero.
    assert float(torch.tensor(1e-310, dtype=torch.float64) * 0.5) == 5e-311


@needs_compiler
def test_a_cached_library_is_compiled_once_and_anew_where_it_is_damaged(tmp_path, monkeypatch):
    source, places = "double thrice(double v) { return 3 * v; }\n", (tmp_path / "first", tmp_path / "second")

    def _file(place):
        monkeypatch.setenv("XDG_CACHE_HOME", str(place))
        load_library.cache_clear()
        code = load_library(source, fast=True)
        code.thrice.argtypes, code.thrice.restype = [ctypes.c_double], ctypes.c_double
        assert code.thrice(1.5) == 4.5
        (file,) = (place / "dynasindy").iterdir()
        return file

    first = _file(places[0])
    written = first.stat().st_ino
    assert _file(places[0]) == first and first.stat().st_ino == written
    (places[1] / "dynasindy").mkdir(mode=0o700, parents=True)
    (places[1] / "dynasindy" / first.name).write_bytes(b"no library")
    assert _file(places[1]).stat().st_size == first.stat().st_size
    first.parent.chmod(0o777)  # anybody may write there
    monkeypatch.setenv("XDG_CACHE_HOME", str(places[0]))
    assert module._cache_file(source, True) is None or not hasattr(os, "getuid")
    load_library.cache_clear()


@needs_compiler
def test_the_libraries_that_were_used_last_stay_in_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(module, "KEPT", 2)
    names = {}
    for name, age in (("one", 300), ("two", 200), ("one", 100), ("three", 0)):
        source = f"double {name}(void) {{ return 1; }}\n"
        load_library.cache_clear()
        load_library(source, fast=True)
        names[name] = file = module._cache_file(source, True)
        os.utime(file, (file.stat().st_mtime - age,) * 2)
    assert {*(tmp_path / "dynasindy").iterdir()} == {names["one"], names["three"]}
    load_library.cache_clear()
