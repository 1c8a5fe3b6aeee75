"""Findings: what was decided or found out about a log, a model or a controller, as data that programs can read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

from dynasindy.sentences import HEADS, sentence

Severity = Literal["note", "weak", "wrong"]


@dataclass(frozen=True)
class Finding:
    """A fact that a user should know; `str()` says it in a sentence, see `dynasindy.sentences`.

    Attributes:
        code: What was found, as `log.gaps`; the first word says of what.
        severity: `note` is good to know, `weak` limits what is promised, `wrong` ends it.
        values: Numbers and names of it, by what they are; times are in s.
    """

    code: str
    severity: Severity = "note"
    values: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return sentence(self.code, self.values)

    def line(self, note: str = "note") -> str:
        """Return it as a line of a report, which begins with its severity, or with what a note is called there."""
        return f"{note if self.severity == 'note' else HEADS[self.severity]}: {self}"

    def record(self) -> dict[str, Any]:
        """Return it as JSON can hold it, numbers that are not finite as `inf`, `-inf` and `nan`."""
        return {"code": self.code, "severity": self.severity, "values": _plain(self.values)}

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Finding:
        """Return the finding that `record` returned."""
        return cls(record["code"], record["severity"], _restored(record["values"]))


class FindingError(ValueError):
    """A fact that stops what was asked for.

    Attributes:
        finding: The fact, of severity `wrong`.
    """

    def __init__(self, code: str, **values: Any) -> None:
        super().__init__(code, values)
        self.finding = Finding(code, "wrong", values)

    def __str__(self) -> str:
        return str(self.finding)

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), **self.finding.values), (self.finding.code,)


class LogError(FindingError):
    """A log that cannot be read as it was asked for."""


def note(code: str, **values: Any) -> Finding:
    """Return a finding that is good to know."""
    return Finding(code, "note", values)


def weak(code: str, **values: Any) -> Finding:
    """Return a finding that limits what is promised."""
    return Finding(code, "weak", values)


def wrong(code: str, **values: Any) -> Finding:
    """Return a finding that ends a promise."""
    return Finding(code, "wrong", values)


def records(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """Return findings as JSON can hold them."""
    return [finding.record() for finding in findings]


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(each) for each in value]
    if isinstance(value, Finding):
        return value.record()
    if hasattr(value, "item"):  # of NumPy or torch
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if value is None or isinstance(value, str | int | bool):
        return value
    raise TypeError(f"a finding holds {value!r}; allowed are numbers, text, lists and mappings")


def _restored(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _restored(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_restored(each) for each in value]
    return float(value) if isinstance(value, str) and value in ("inf", "-inf", "nan") else value
