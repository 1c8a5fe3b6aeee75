"""A plant whose equations nobody knows: what it measures and what moves it, in names and units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from torch import Tensor

from dynasindy.systems.base import Signature, System


class Unknown(System):
    """Names and units of a rig; equations are found from its logs, and so are the ranges of its states.

    Args:
        states: What the rig measures, in the order in which it sends it: the unit of each state.
        inputs: What moves it, in the order in which it takes it: names, or each name with the two ends of its actuator
            in the actuator's own unit, such as `{"pump": [0, 12]}` of a pump in V.

    Raises:
        ValueError: There is no state or no input, or a name, a unit or an end is none.
    """

    known = False

    def __init__(self, states: Mapping[str, str], inputs: Sequence[str] | Mapping[str, Sequence[float]]) -> None:
        if not states or not inputs:
            raise ValueError(
                f"a rig has states {dict(states or {})} and inputs {inputs}; give one or more of each, such as "
                "system.states={angle: rad} and system.inputs=[motor]"
            )
        ends: tuple[tuple[float, float], ...] = ()
        if isinstance(inputs, Mapping):
            if wrong := [name for name, given in inputs.items() if len(given) != 2]:
                raise ValueError(
                    f"system.inputs has {wrong[0]}: {list(inputs[wrong[0]])}; give the two ends of its actuator, such "
                    "as {pump: [0, 12]}"
                )
            ends = tuple((float(low), float(high)) for low, high in inputs.values())
        super().__init__(
            Signature(tuple(states), tuple(states.values()), tuple(inputs), (1.0,) * len(states), input_ends=ends)
        )

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Refuse to say how the plant moves.

        Raises:
            RuntimeError: Always, as nobody knows.
        """
        raise RuntimeError(
            "nobody knows its equations, so it cannot be simulated; fly the rig with rig.py, or plan from a log of it "
            "with data=csv"
        )
