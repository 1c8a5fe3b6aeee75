"""One name and one look per controller, the same in every figure and table."""

import re
from collections.abc import Iterable, Mapping
from typing import Any

from dynasindy.viz.style import BLUE, CYCLE, GREEN, ORANGE, PURPLE, RED, SKY

# The default and the paper's three settings have a colour and a solid line; of the others, kin share a colour.
CONTROLLERS: Mapping[str, tuple[str, str, str]] = {
    "gradient": ("policy", BLUE, "-"),
    "gradient_integral": ("policy, integral action", BLUE, "--"),
    "rollouts_0": ("no planning", RED, "-"),
    "rollouts_400": ("400 rollouts", SKY, "-"),
    "rollouts_800": ("800 rollouts", GREEN, "-"),
    "rollouts_0_tuned": ("TD3 tuned for no planning", RED, "--"),
    "sb3_sac": ("SAC", PURPLE, "-"),
    "sb3_sac_5": ("SAC, five updates per step", PURPLE, "--"),
    "sb3_td3": ("Stable-Baselines3's TD3", ORANGE, "-"),
    "sb3_td3_5": ("Stable-Baselines3's TD3, five updates per step", ORANGE, "--"),
}
"""What the default, the paper's settings and agents without a model are called; colour and dashes of their lines."""


def controller_name(setting: str) -> str:
    """Return the words for a setting: `rollouts_800` is `800 rollouts`."""
    if setting in CONTROLLERS:
        return CONTROLLERS[setting][0]
    found = re.fullmatch(r"rollouts_(\d+)", setting)
    return f"{found[1]} rollouts" if found else setting if "," in setting else setting.replace("_", " ")


def name_by_planning(planning: Mapping[str, Any]) -> str:
    """Return the words for a controller by the settings of its planning, as a run's config has them.

    Args:
        planning: Its `_target_` and arguments, `rollouts` among them where rollouts are imagined.
    """
    kind = str(planning.get("_target_", "")).rpartition(".")[2]
    if kind in ("NoPlanning", "ImaginedReplay"):
        return controller_name(f"rollouts_{planning.get('rollouts') or 0}")
    return controller_name({"GradientPlanning": "gradient"}.get(kind, "policy"))


def line_styles(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return colour and dashes per controller of a figure, by its setting or its words, as matplotlib takes them.

    One that is known looks the same everywhere; others take the colours of the cycle that are left, in their order.
    """
    known = {name: look for setting, (words, *look) in CONTROLLERS.items() for name in (setting, words)}
    chosen = list(names)
    taken = {known[name][0] for name in chosen if name in known}
    free = [colour for colour in CYCLE if colour not in taken] or list(CYCLE)
    others = [name for name in chosen if name not in known]
    known |= {name: [free[k % len(free)], "-"] for k, name in enumerate(others)}
    return {name: dict(zip(("color", "linestyle"), known[name], strict=True)) for name in chosen}
