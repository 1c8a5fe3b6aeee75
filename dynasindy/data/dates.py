"""Dates with their time of day, as logs write them, in seconds."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime

DAY_FIRST = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})(?:[ T]+(\d{1,2})(:\d{2}.*))?")
"""A date as it is written with points, the day first: with slashes nobody could tell the day from the month."""
ALLOWED = "2024-05-31 12:00:00.05 or 31.05.2024 12:00:00.05"
"""Dates that are read, for messages."""


def seconds_of_date(text: str) -> float:
    """Return the seconds of a date with its time of day, by ISO 8601 or with points; NaN of what is none."""
    text = text.strip()
    if found := DAY_FIRST.fullmatch(text):
        day, month, year, hour, rest = found.groups()
        text = f"{year}-{month:0>2}-{day:0>2}T{hour or '0':0>2}{rest or ':00'}"
    try:
        date = datetime.fromisoformat(text)
    except ValueError:
        return math.nan
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()  # else summer time would leave a gap
