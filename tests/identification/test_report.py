"""What was identified, in words and in files."""

import json
from functools import partial

import torch

from dynasindy.dyna.simulated import Simulated
from dynasindy.envs import Chirp
from dynasindy.findings import Finding, note
from dynasindy.identification.identify import Identified
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.systems import Pendulum

EXCITATION = partial(Chirp, duration=10.0, amplitude=0.6)


def test_everything_is_written(tmp_path):
    source = Simulated(validation_seconds=2.0).load(Pendulum(), EXCITATION)
    found = Identified.of(SindyModel(source.signature, ["u"], Regression("bic"), Refinement("one_step")), source)
    before = [note("log.gaps", count=1)]
    found.save(tmp_path / "run", before)
    names = {p.name for p in (tmp_path / "run").iterdir()}
    tables = {f"coefficients.{suffix}" for suffix in ("txt", "csv")}
    assert names == {"model.json", "metrics.json", "report.txt", *tables}
    written = json.loads((tmp_path / "run/metrics.json").read_text())
    assert [Finding.from_record(each) for each in written.pop("findings")] == [*before, *found.findings]
    assert written == found.metrics
    assert torch.equal(SindyModel.load(tmp_path / "run/model.json").coefficients, found.model.coefficients)
