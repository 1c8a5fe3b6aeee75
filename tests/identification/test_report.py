"""What was identified, in words and in files."""

import json
from dataclasses import replace
from functools import partial

import pytest
import torch

from dynasindy.dyna.simulated import Simulated
from dynasindy.excitation import Chirp
from dynasindy.findings import Finding, note
from dynasindy.identification.identify import identify_source
from dynasindy.identification.report import describe_restarts, to_words, write_identification
from dynasindy.sindy import Refinement, Regression, SindyModel
from dynasindy.systems import Pendulum
from dynasindy.systems.transitions import Transitions

EXCITATION = partial(Chirp, duration=10.0, amplitude=0.6)


def test_coefficients_without_standard_errors_say_why():
    source = Simulated().load(Pendulum(), EXCITATION)
    given = SindyModel(source.signature, ["Omega", "u"], known={"theta": "Omega", "Omega": "u"})
    words = to_words(identify_source(given, source), source)
    assert "no standard errors" in words
    x = torch.randn(1001, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    noise = replace(source, training=replace(source.training, x=x[:-1], x_next=x[1:]))
    model = SindyModel(source.signature, ["u", "1"], refinement=Refinement("one_step"))
    found = identify_source(model, noise)
    said = "the refinement, which tells them, found no equations, or ones that run away from the data"
    assert f"coefficients have no standard errors (±): {said}" in to_words(found, noise).splitlines()
    assert "fit.dropped" in [each.code for each in found.report.findings]


def test_everything_is_written(tmp_path):
    source = Simulated(validation_seconds=2.0).load(Pendulum(), EXCITATION)
    found = identify_source(SindyModel(source.signature, ["u"], Regression("bic"), Refinement("one_step")), source)
    before = [note("log.gaps", count=1)]
    write_identification(found, source, tmp_path / "run", before)
    names = {p.name for p in (tmp_path / "run").iterdir()}
    tables = {f"coefficients.{suffix}" for suffix in ("txt", "tex", "csv")}
    assert names == {"model.json", "metrics.json", "report.txt", *tables}
    written = json.loads((tmp_path / "run/metrics.json").read_text())
    assert [Finding.from_record(each) for each in written.pop("findings")] == [*before, *found.findings]
    assert written == found.metrics
    assert torch.equal(SindyModel.load(tmp_path / "run/model.json").coefficients, found.model.coefficients)


@pytest.mark.parametrize(
    ("segments", "said"),
    [([0] * 6, ""), ([0, 0, 1, 1, 1, 1], ", begun anew after its gap"), ([0, 1, 1, 2, 2, 2], " each of its 2 gaps")],
)
def test_a_prediction_of_data_with_gaps_is_said_to_begin_anew(segments, said):
    data = Transitions.from_trajectory(torch.zeros(7, 1), torch.zeros(6, 1), 0.1)
    told = describe_restarts(Transitions(data.x, data.u, data.x_next, data.dt, torch.tensor(segments)))
    assert told.endswith(said) and bool(told) == bool(said)
