"""FMUs that `export` writes are valid, and move as the model does, as FMPy says."""

import shutil

import numpy as np
import pytest
import torch

from dynasindy.sindy import SindyModel

CC = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)


@pytest.mark.skipif(CC is None, reason="there is no C compiler on this computer")
@pytest.mark.parametrize("version", [2, 3])
def test_fmus_are_valid_and_move_as_the_model(command, planned, tmp_path, version):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed: pip install -e '.[export]'")
    from fmpy.validation import validate_fmu

    words = (f"run={planned}", "formats=[fmu]", f"fmi={version}", "folder=out")
    done = command("export", *words, cwd=tmp_path)
    assert done.code == 0, done
    plant, controller = (str(tmp_path / "out" / f"{name}.fmu") for name in ("plant", "controller"))
    assert validate_fmu(plant) == validate_fmu(controller) == []
    found = fmpy.simulate_fmu(plant, stop_time=0.2, step_size=0.01, output_interval=0.01, start_values={"u_u": 0.4})
    model, x = SindyModel.load(planned / "model.json"), torch.zeros(2, dtype=torch.float64)
    for _ in range(200):  # by Euler's steps of a millisecond
        with torch.no_grad():
            x = x + 0.001 * model(x, torch.tensor([0.4], dtype=torch.float64))
    np.testing.assert_allclose([found["x_theta"][-1], found["x_Omega"][-1]], x.numpy(), rtol=0.02)
    acted = fmpy.simulate_fmu(controller, stop_time=0.2, start_values={"r_theta": 0.3})
    assert 0 < np.abs(acted["u_u"]).max() <= 1
