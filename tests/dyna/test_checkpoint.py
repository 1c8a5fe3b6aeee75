import os

import pytest
import torch

from dynasindy.dyna.run import Checkpoints


def test_the_newest_two_are_kept_and_the_newest_is_read(tmp_path):
    checkpoints = Checkpoints(tmp_path / "checkpoints")
    assert checkpoints.newest() is None
    for number in (1, 2, 10):
        checkpoints.save(number, {"number": number, "weights": torch.full((3,), float(number))})
    assert sorted(file.name for file in checkpoints.folder.iterdir()) == ["000002.pt", "000010.pt"]
    state = checkpoints.newest()
    assert state["number"] == 10 and torch.equal(state["weights"], torch.full((3,), 10.0))


@pytest.mark.parametrize(
    "damage",
    [
        lambda raw: raw[:-1],  # the end is missing, as after a power cut
        lambda raw: raw[:100],
        lambda raw: b"",
        lambda raw: raw[:-200] + bytes([raw[-200] ^ 1]) + raw[-199:],  # one bit of the payload
        lambda raw: b"something else\n" + raw,
        lambda raw: raw + b"0",
    ],
)
def test_a_damaged_file_is_passed_over_for_the_one_before(tmp_path, damage):
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(1, {"number": 1})
    newest = checkpoints.save(2, {"number": 2, "weights": torch.zeros(100)})
    newest.write_bytes(damage(newest.read_bytes()))
    assert checkpoints.newest() == {"number": 1}


class Payload:
    def __reduce__(self):
        return os.system, ("touch canary",)


def test_a_checkpoint_is_data_and_runs_no_code(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    checkpoints = Checkpoints(tmp_path / "checkpoints")
    checkpoints.save(1, {"attack": Payload()})
    assert checkpoints.newest() is None
    assert not (tmp_path / "canary").exists()


def test_what_is_removed_is_what_was_made(tmp_path):
    checkpoints = Checkpoints(tmp_path / "checkpoints")
    checkpoints.save(1, {})
    (checkpoints.folder / "mine.txt").write_text("keep")
    checkpoints.remove()
    assert [file.name for file in checkpoints.folder.iterdir()] == ["mine.txt"]


def test_a_disk_that_cannot_be_read_is_no_reason_to_begin_anew(tmp_path, monkeypatch):
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(1, {"number": 1})

    def fail(*_, **__):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(type(tmp_path), "open", fail)
    with pytest.raises(OSError, match="Input/output"):
        checkpoints.newest()
    monkeypatch.undo()
    assert checkpoints.newest() == {"number": 1}
