"""One name and one colour per controller, the same in every figure and table."""

from collections.abc import Iterable, Mapping

from dynasindy.viz.style import BLUE, CYCLE, GREEN, ORANGE, PURPLE, RED, SKY

BROWN = "#5D3A1A"
"""For the one controller for which the palette has no colour left; grey explains lines and bands in legends."""
NAMES: Mapping[str, str] = {
    "rollouts_0": "no planning",
    "rollouts_400": "400 rollouts",
    "rollouts_800": "800 rollouts",
    "gradient": "planning by gradient",
    "rollouts_0_tuned": "TD3 tuned for no planning",
    "direct": "direct TD3",
    "sb3_sac": "SAC",
    "sb3_sac_5": "SAC, five updates per step",
    "sb3_td3": "Stable-Baselines3's TD3",
    "sb3_td3_5": "Stable-Baselines3's TD3, five updates per step",
    "oracle": "true plant as the model",
    "pysindy": "PySINDy as the model",
    "pysindy_gate_off": "PySINDy as the model, gate off",
}
"""Words for a setting of the ablation; of the others the name itself says what they vary."""
COLOURS: Mapping[str, str] = {
    "rollouts_0": RED,
    "rollouts_400": GREEN,
    "rollouts_800": BLUE,
    "gradient": PURPLE,
    "rollouts_0_tuned": RED,
    "direct": ORANGE,
    "sb3_sac": GREEN,
    "sb3_sac_5": PURPLE,
    "sb3_td3": SKY,
    "sb3_td3_5": BROWN,
    "oracle": ORANGE,
    "pysindy": GREEN,
    "pysindy_gate_off": PURPLE,
    "horizon_1": ORANGE,
    "horizon_5": SKY,
    "horizon_20": GREEN,
    "horizon_100": PURPLE,
    "horizon_400": RED,
    "real_share_05": ORANGE,
    "real_share_25": GREEN,
    "real_share_50": PURPLE,
}
"""Those that share a figure differ; with more controllers than colours some that never do share one."""


def named(setting: str) -> str:
    """Return the words for a setting: `rollouts_800` is `800 rollouts`, `horizon_20` is `horizon 20`."""
    return NAMES.get(setting, setting if "," in setting else setting.replace("_", " "))


def colours(names: Iterable[str]) -> dict[str, str]:
    """Return a colour per controller of a figure, by its setting or its words.

    One that is known has the same colour everywhere; others take those of the cycle that are left, in their order.
    """
    known = {**COLOURS, **{named(setting): colour for setting, colour in COLOURS.items()}}
    chosen = list(names)
    taken = {known[name] for name in chosen if name in known}
    free = [colour for colour in CYCLE if colour not in taken] or list(CYCLE)
    left = [name for name in chosen if name not in known]
    return {name: known.get(name) or free[left.index(name) % len(free)] for name in chosen}
