"""What the gate saw and decided, and what became of each refit."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from dynasindy.viz.style import BLACK, BLUE, GREY, ORANGE, RED, Array, array, name_single, panels, styled


@styled
def gate(decisions: Mapping[str, ArrayLike], title: str = "Trust in the model") -> Figure:
    """Draw the reward error with its thresholds, shaded while the gate is closed, and the test of each refit.

    Args:
        decisions: The columns of `gate.csv`, `(n_episodes,)` each: `episode`; `reward_error` per control period of the
            whole episode, replayed through the model before its refit; `judged_reward_error` of the model that stays,
            on held-out windows, NaN where no planning was due; the thresholds `open_below` and `close_above`; `open`,
            1 or 0; and of the refit `held_out_error_before`, `held_out_error_after` and `refit_kept`, NaN without a
            test.
        title: of the figure.
    """
    columns = {name: array(values) for name, values in decisions.items()}
    x, before, after = (columns[name] for name in ("episode", "held_out_error_before", "held_out_error_after"))
    figure, (upper, lower) = panels(2, 1, (7.0, 5.0), title)
    dots: dict[str, Any] = {"marker": "o", "markersize": 3}
    upper.plot(x, columns["reward_error"], color=GREY, label="whole episode, before the refit", **dots)
    upper.plot(x, columns["judged_reward_error"], color=BLUE, label="held-out windows, judged", **dots)
    # Half an episode to each side, so that a single one has thresholds too.
    wide = np.concatenate([x[:1] - 0.5, x, x[-1:] + 0.5])
    for name, line, words in (("open_below", ":", "opens below"), ("close_above", "--", "closes above")):
        bound = np.pad(columns[name], 1, mode="edge")
        upper.plot(wide, bound, color=BLACK, linestyle=line, linewidth=0.9, label=words)
    for closed in x[columns["open"] == 0]:
        upper.axvspan(closed - 0.5, closed + 0.5, color=GREY, alpha=0.25, linewidth=0)
    upper.set_yscale("log")
    name_single(upper, x, columns["judged_reward_error"], BLUE)
    upper.set_ylabel("reward error [per period]")
    upper.legend()
    lower.plot(x, before, color=ORANGE, label="before the refit", **dots)
    lower.plot(x, after, color=BLUE, label="after the refit", **dots)
    back = columns["refit_kept"] == 0
    if back.any():
        lower.plot(x[back], after[back], color=RED, marker="x", linestyle="none", label="rolled back")
    if np.isfinite(before).any():
        lower.set_yscale("log")
        lower.set_ylim(*_decades(np.concatenate([before, after])))
    name_single(lower, x, after, BLUE)
    lower.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    lower.set_xlim(wide[0], wide[-1])
    lower.set_xlabel("real episode")
    lower.set_ylabel("held-out state error [ranges]")
    lower.legend()
    return figure


def _decades(values: Array) -> tuple[float, float]:
    """Return the whole decades around positive values, which have ticks; at least one."""
    logs = np.log10(values[np.isfinite(values) & (values > 0)])
    low, high = (np.floor(logs.min()), np.ceil(logs.max())) if len(logs) else (0.0, 0.0)
    return float(10**low), float(10 ** max(high, low + 1))
