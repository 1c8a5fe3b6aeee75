"""The data say that an axis is pushed by forces that nobody measures."""

import numpy as np
import torch

from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.refinement import Refinement
from dynasindy.sindy.regression import Regression
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

TRUE = {"u": 1.0, "v": -2.0, "tanh(100 v)": -0.2}
SIGNATURE = Signature(("q", "v"), ("m", "m/s"), ("u",), (0.3, 0.2))


def axis(seed: int) -> Transitions:
    """A mass with friction that a controller moves to and fro; forces push it at random that nobody measures."""
    rng, dt, inner = np.random.default_rng(seed), 0.02, 10
    q = v = 0.0
    positions, inputs = [q], []
    for k in range(1000):
        aim = 0.25 * np.sin(0.9 * k * dt) + 0.1 * np.sin(2.3 * k * dt)
        u = 30 * (aim - q - 1e-4 * rng.normal()) - 2 * v
        force = 0.3 * rng.normal()
        for _ in range(inner):
            v += dt / inner * (TRUE["u"] * u + TRUE["v"] * v + TRUE["tanh(100 v)"] * np.tanh(100 * v) + force)
            q += dt / inner * v
        positions.append(q)
        inputs.append(u)
    y = np.full((1001, 2), np.nan)
    y[:, 0] = np.array(positions) + 1e-4 * rng.normal(size=1001)
    return Transitions.from_trajectory(torch.from_numpy(y), torch.tensor(inputs).unsqueeze(-1).double(), dt)


def fitted(data: Transitions, error: str) -> tuple[dict[str, float], str]:
    """The coefficients of v' by name, and what the report says."""
    model = SindyModel(
        SIGNATURE, [*TRUE], Regression("bic"), Refinement("trajectory", window=50, error=error), known={"q": "v"}
    )
    report = model.fit(data)
    return dict(zip(model.library.names, model.coefficients[:, 1].tolist(), strict=True)), report.to_text()


def wrong(found: dict[str, float]) -> float:
    return float(np.sqrt(np.mean([(found[name] / value - 1) ** 2 for name, value in TRUE.items()])))


def test_the_data_say_that_an_axis_is_pushed():
    found, told = fitted(axis(0), "auto")
    assert "error=prediction" in told and "pushes the plant" in told and wrong(found) < 0.2
