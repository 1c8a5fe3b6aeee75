"""What the paper prints, against the plant `xi` and the settings of its experiment."""

from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from dynasindy.systems import Xi
from dynasindy.systems.twin_rotor import SIGNATURE
from dynasindy.viz.report.published import HYPERPARAMETERS, XI
from dynasindy.world_models import SindyModel


def test_the_printed_coefficients_are_the_plant_xi():
    model = SindyModel(SIGNATURE, "paper_table")
    for state, row in XI.items():
        for name, value in row.items():
            model.coefficients[model.library.names.index(name), SIGNATURE.state_names.index(state)] = value
    scale = torch.tensor(SIGNATURE.x_scale, dtype=torch.float64)
    x, u = scale * torch.randn(32, 6, dtype=torch.float64), torch.rand(32, 2, dtype=torch.float64) * 2 - 1
    torch.testing.assert_close(model(x, u), Xi()(x, u))


def test_each_hyperparameter_has_a_key_that_exists():
    with initialize_config_dir(str(Path(__file__).parents[3] / "conf"), version_base="1.3"):
        config = compose("train", ["experiment=paper"])
    assert [OmegaConf.select(config, key) for *_, key in HYPERPARAMETERS] == [
        value for _, _, value, _ in HYPERPARAMETERS
    ]
