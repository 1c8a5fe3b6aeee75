"""C sources with gaps: `@word@` is replaced, and lines between `@if flag` and `@end` stay where the flag is set."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from importlib import resources


def fill(name: str, words: Mapping[str, object], flags: Collection[str] = ()) -> str:
    """Return the text of a template with its gaps filled.

    What is filled in is not looked at again, so that words of a file cannot open gaps of their own.

    Args:
        name: File in `dynasindy/export/c`.
        words: What stands for each `@word@`.
        flags: Which `@if` are true; `@if !flag` is true where the flag is not set.

    Raises:
        KeyError: A gap has no word.
    """
    text = resources.files("dynasindy.export").joinpath("c", name).read_text(encoding="utf-8")
    kept: list[str] = []
    shown = [True]
    for line in text.splitlines():
        if line.startswith("@if "):
            flag = line.split()[1]
            shown.append(shown[-1] and (flag.lstrip("!") in flags) != flag.startswith("!"))
        elif line == "@end":
            shown.pop()
        elif shown[-1]:
            kept.append(re.sub(r"@(\w+)@", lambda gap: str(words[gap[1]]), line))
    return "\n".join(kept) + "\n"
