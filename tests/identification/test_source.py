"""What a log is cut into, and which states are added to it."""

from dataclasses import replace

import pytest
import torch

from dynasindy.data.recording import Recording
from dynasindy.findings import note
from dynasindy.identification.source import Source
from dynasindy.sindy import SindyModel
from dynasindy.systems.base import Signature
from dynasindy.systems.transitions import Transitions

SIGNATURE = Signature(("q", "p"), ("rad", "-"), ("u",), (1.0, 1.0))


def recording(rows=8):
    x = torch.arange(2.0 * (rows + 1)).reshape(rows + 1, 2)
    return Recording(Transitions.from_trajectory(x, torch.zeros(rows, 1), 0.1), SIGNATURE, (note("log.gaps", count=1),))


def test_a_source_is_simulated_and_without_findings_unless_it_is_said():
    data = Transitions.from_trajectory(torch.zeros(3, 1), torch.zeros(2, 1), 0.1)
    source = Source(Signature(("x",), ("m",), ("u",), (1.0,)), data, data)
    assert not source.logged and source.findings == ()


@pytest.mark.parametrize(("share", "rows"), [(0.25, 6), (0.5, 4), (0.0, 8)])
def test_the_last_part_of_a_log_is_kept_and_all_of_it_is_one_stretch_again(share, rows):
    log = recording()
    source = Source.of(log, share)
    assert (len(source.training), len(source.validation)) == (rows, 8 - rows)
    assert source.logged and source.findings == log.findings
    assert repr(source).startswith(f"Data of {rows} rows, ") and f"{8 - rows} rows more to judge on" in repr(source)
    assert torch.equal(source.whole.x, log.transitions.x)
    assert torch.equal(source.whole.segment, log.transitions.segment)


def test_stretches_that_do_not_follow_each_other_stay_apart():
    data = recording(8).transitions
    gap = Source.of(Recording(data.select(torch.arange(8) != 6), SIGNATURE), 1 / 7)  # cut where row 6 is missing
    assert len(gap.validation) == 1
    assert gap.whole.segment.tolist() == [0] * 6 + [1]


@pytest.mark.parametrize("share", [-0.1, 1.0])
def test_a_share_that_is_none_is_refused(share):
    with pytest.raises(ValueError, match=f"validation_share is {share}; allowed is 0 to below 1"):
        Source.of(recording(), share)


def test_a_rate_that_was_not_logged_is_a_state_that_no_sensor_sees():
    source = Source.of(recording()).with_rates({"q": "w", "p": "p_rate", "other": "none"})
    assert source.signature.state_names == ("q", "p", "w", "p_rate")
    assert source.signature.state_units == ("rad", "-", "rad/s", "1/s")
    for part in (source.training, source.validation):
        assert part.x[:, 2:].isnan().all() and not part.x[:, :2].isnan().any()
    assert source.findings[-2:] == tuple(note("log.unmeasured", state=name) for name in ("w", "p_rate"))
    again = source.with_rates({"q": "w"})
    assert again.signature == source.signature and again.findings == source.findings


def test_data_get_the_states_of_a_model_and_those_of_another_plant_are_refused():
    wide = Signature(("q", "p", "w"), ("rad", "-", "rad/s"), ("u",), (1.0, 1.0, 3.0))
    model = SindyModel(wide, ["1", "u", "w"], known={"q": "w"})
    source = Source.of(recording()).with_states_of(model)
    assert source.signature == wide and source.training.x.shape[1] == 3
    with pytest.raises(ValueError, match="states"):
        Source.of(recording()).with_states_of(SindyModel(wide, ["1", "u", "w"]))


def test_a_rate_that_was_not_logged_leaves_the_inputs_their_own_units():
    source = Source.of(recording())
    volts = replace(source, signature=replace(SIGNATURE, input_ends=((0.0, 12.0),)))
    assert volts.with_rates({"q": "w"}).signature.input_ends == ((0.0, 12.0),)


def test_a_model_of_other_limits_is_refused():
    """0 to 12 V is not -12 to 12 V, though 0 V is zero and 12 V is one in both."""
    volts = replace(SIGNATURE, input_ends=((-12.0, 12.0),))
    model = SindyModel(replace(volts, input_limits=((0.0, 1.0),)), ["1", "u"])
    source = replace(Source.of(recording()), signature=volts)
    with pytest.raises(ValueError, match="ends"):
        source.with_states_of(model)


@pytest.mark.parametrize(("ends", "same"), [((0.0300001, 11.97), True), ((0.03, 11.98), False), (None, False)])
def test_ends_of_inputs_are_the_same_up_to_the_digits_that_a_note_tells(ends, same):
    wide = Signature(("q", "p", "w"), ("rad", "-", "rad/s"), ("u",), (1.0, 1.0, 3.0), ((0.03, 11.97),))
    model = SindyModel(wide, ["1", "u", "w"], known={"q": "w"})
    source = Source.of(recording())
    source = replace(source, signature=replace(SIGNATURE, input_ends=(ends,) if ends else ()))
    if same:
        assert source.with_states_of(model).signature == wide
    else:
        with pytest.raises(ValueError, match="ends"):
            source.with_states_of(model)
