"""Syntax trees of formulas, for several threads at once."""

from __future__ import annotations

import ast
import threading

_ALONE = threading.Lock()


def parsed(formula: str) -> ast.expr:
    """Return the syntax tree of a formula.

    One thread parses at a time: CPython 3.11 counts the depth of trees for all threads together, and ends in a
    SystemError ("AST constructor recursion depth mismatch") where one begins while another is at it.

    Raises:
        SyntaxError: It is no expression of Python.
        ValueError: It holds characters that no source may hold.
    """
    with _ALONE:
        return ast.parse(formula, mode="eval").body
