"""What ties a figure of a page to the file it was read from, and what is left over.

A `Tie` holds words of a page with `{}` where figures stand, and the figures as the page must show them, worked out
from files. Line breaks do not matter. A figure is a number with a decimal point or an exponent, outside of code.
"""

import re
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
FIGURE = re.compile(r"(?<![\w.])[-+]?(?:\d*\.\d+(?:e[-+]?\d+)?|\d+e[-+]?\d+)(?!\w|\.\d)")
CODE = re.compile(r"`[^`]*`")


@dataclass(frozen=True)
class Tie:
    """Words of a page and the figures in them."""

    page: str
    words: str
    figures: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The words with their figures, as they must stand in the page."""
        return flat(self.words.format(*self.figures))


@dataclass(frozen=True)
class Untied:
    """Words of a page whose figures no file holds, and why; after `...` the rest of the row or paragraph, too."""

    page: str
    words: str
    reason: str


def flat(text: str) -> str:
    """Return a text on one line."""
    return " ".join(text.split())


def read(page: str) -> str:
    """Return a page without blocks of code."""
    text = (REPOSITORY / page).read_text()
    text = re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)
    return re.sub(r"(?<=\n\n)(?: {4}.*\n)+", "", text)


def paragraphs(text: str) -> list[str]:
    """Return the paragraphs, list items and rows of tables of a page, each on one line."""
    parts = re.split(r"\n\s*\n|\n(?=\s*(?:[*-]|\d+\.) )|\n(?=\|)|(?<=\|)\n", text)
    return [flat(part) for part in parts if part.strip()]


def figures(text: str) -> list[str]:
    """Return the figures of a text."""
    return FIGURE.findall(CODE.sub("", text))


def left_over(text: str, tied: list[str]) -> list[str]:
    """Return the paragraphs of a text that hold figures besides those in tied words, these blotted out."""
    text = "\n\n".join(paragraphs(text))
    for words in sorted(tied, key=len, reverse=True):
        rest = ".*" * words.endswith("...")
        text = re.sub(re.escape(words.removesuffix("...")) + rest, " [tied] ", text)
    return [part for part in text.split("\n\n") if figures(part)]
