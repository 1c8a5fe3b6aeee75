"""What is asked of peers and what is made of their answers; the peers themselves are not installed here."""

import math
import sys

import numpy as np
import pytest
import torch
from benchmark import parse
from benchmarks import peers
from benchmarks.peers import serve

from dynasindy.dyna.simulated import record_plant
from dynasindy.envs import Multisine
from dynasindy.safe_io import read_rows
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.systems import Tras
from dynasindy.systems.equilibria import find_equilibria

PROPORTIONAL = """
import sys
sys.path.insert(0, {here!r})
from serve import answer, control, settings
asked = settings()
print("a library talks")
answer(version="1.2", cpu=3.5, found=asked.get("y_test"))
control(lambda x, r, first, flight: asked["gain"] * (r - x[:2]) + 0.1 * flight)
"""


@pytest.fixture
def script(tmp_path, monkeypatch):
    (tmp_path / "stub.py").write_text(PROPORTIONAL.format(here=str(peers.HERE)))
    monkeypatch.setattr(peers, "HERE", tmp_path)
    monkeypatch.setattr(peers, "environment", lambda folder, name: sys.executable)
    return "stub.py"


def test_a_peer_flies_by_lines_and_what_its_library_prints_is_no_answer(script):
    with peers.peer(sys.executable, script, {"gain": 2.0}) as found:
        assert found.first == {"version": "1.2", "cpu": 3.5, "found": None}
        from tensordict import TensorDict

        x, r = torch.tensor([[0.1, 0.2, 9.0], [0.0, 0.0, 9.0]]), torch.tensor([[0.2, 0.1], [0.3, -2.0]])
        steps = torch.zeros(2, 1, dtype=torch.int64)
        acted = found(TensorDict({"state": x, "reference": r, "step_count": steps}, [2]))
        torch.testing.assert_close(acted["action"], torch.tensor([[0.2, -0.2], [0.7, -1.0]]))
        assert found.calls == 2
    assert found.process.returncode == 0


def test_models_are_scored_on_the_test_log_and_rows_have_ours_beside_them(script, tmp_path, monkeypatch):
    y = np.stack([np.linspace(0, 2, 5), np.linspace(0, 8, 5)], -1)
    data = {"u": y, "y": y, "u_test": y, "y_test": y, "states_measured": True}
    assert peers.score_model("tras", y + np.array([0.2, 0.8]), data) == (pytest.approx(0.1), "of the range")
    assert peers.score_model("emps", y + 1e-3, data) == (pytest.approx(1.0), "mm")
    monkeypatch.setattr(peers, "LOGS", {"tras": lambda folder, seed: (data, peers.row_of("ours", "0", 0.5, "x", 1.0))})
    monkeypatch.setattr(peers, "SCRIPTS", dict.fromkeys(peers.SCRIPTS, script))
    out = tmp_path / "peers.csv"
    words = ["--peers", "SysIdentPy", "jax-sysid", "--environments", str(tmp_path), "--seeds", "7", "--out", str(out)]
    monkeypatch.setitem(data, "gain", 0.0)
    peers.main(parse("peers", words))
    first, second = read_rows(out)
    assert (first["peer"], first["value"], second["peer"], second["version"]) == ("ours", "0.5", "jax-sysid", "1.2")
    assert (float(second["value"]), second["cpu_seconds"], second["seed"]) == (0.0, "3.5", "7")
    assert list(first) == list(peers.COLUMNS)


def test_logs_of_rigs_need_their_folder():
    with pytest.raises(SystemExit, match="--data"):
        peers.LOGS["tanks"](None, 0)


def test_the_hint_of_do_mpc_is_where_the_rotors_rest():
    """At a target the root of the hint's square is the speed of the rotor at rest there, h |h| = sum of monomials."""
    model = SindyModel(Tras().signature, "rotor", Regression("bic", tolerance=1e-4), Refinement(), known=peers.KNOWN)
    signal = Multisine(2, amplitude=(0.3, 0.1), offset=(-0.11, 0.25), seed=400)
    model.fit(record_plant(Tras(), signal.samples(0.01), 0.01, 10))
    plan = peers.nmpc_plan(model, 0.05)
    target = torch.tensor([[0.2, 0.1]], dtype=torch.float64)
    (rest,) = find_equilibria(Tras(), [0, 1], target, torch.zeros(6), 0.05).x
    for name, of in plan["hint"].items():
        square = sum(c * m for c, m in zip(of, serve.monomials(target[0].tolist()), strict=True))
        speed = float(rest[Tras().signature.state_index(name)])
        assert math.copysign(math.sqrt(abs(square)), square) == pytest.approx(speed, rel=0.05)
