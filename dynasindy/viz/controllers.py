"""One name and one look per controller, the same in every figure and table."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from dynasindy.viz.style import BLUE, CYCLE, GREEN, ORANGE, PURPLE, RED, SKY


@dataclass(frozen=True)
class ControllerStyle:
    """What a controller is called, and the line that it is drawn as; no other has both its colour and its dashes."""

    words: str
    colour: str
    dashes: str = "-"

    @property
    def look(self) -> dict[str, Any]:
        """Colour and dashes, as matplotlib takes them."""
        return {"color": self.colour, "linestyle": self.dashes}


# The default and the paper's three settings have a colour and a solid line; of the others, kin share a colour.
CONTROLLERS: Mapping[str, ControllerStyle] = {
    "gradient": ControllerStyle("policy", BLUE),
    "gradient_integral": ControllerStyle("policy, integral action", BLUE, "--"),
    "rollouts_0": ControllerStyle("no planning", RED),
    "rollouts_400": ControllerStyle("400 rollouts", SKY),
    "rollouts_800": ControllerStyle("800 rollouts", GREEN),
    "rollouts_0_tuned": ControllerStyle("TD3 tuned for no planning", RED, "--"),
    "sb3_sac": ControllerStyle("SAC", PURPLE),
    "sb3_sac_5": ControllerStyle("SAC, five updates per step", PURPLE, "--"),
    "sb3_td3": ControllerStyle("Stable-Baselines3's TD3", ORANGE),
    "sb3_td3_5": ControllerStyle("Stable-Baselines3's TD3, five updates per step", ORANGE, "--"),
}
"""The default, the paper's settings, and agents without a model."""


def controller_name(setting: str) -> str:
    """Return the words for a setting: `rollouts_800` is `800 rollouts`."""
    if setting in CONTROLLERS:
        return CONTROLLERS[setting].words
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
    known = {**CONTROLLERS} | {one.words: one for one in CONTROLLERS.values()}
    chosen = list(names)
    taken = {known[name].colour for name in chosen if name in known}
    free = [colour for colour in CYCLE if colour not in taken] or list(CYCLE)
    left = [name for name in chosen if name not in known]
    others = {name: ControllerStyle(name, free[k % len(free)]) for k, name in enumerate(left)}
    return {name: (known.get(name) or others[name]).look for name in chosen}
