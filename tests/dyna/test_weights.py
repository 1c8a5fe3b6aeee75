"""Weights of a policy that were saved, against those of the network that is to have them."""

import zipfile

import pytest
import torch
from torch import nn

from dynasindy.dyna.folder import read_weights


def test_the_network_acts_as_the_one_that_was_saved(tmp_path):
    saved, network = nn.Linear(3, 2), nn.Linear(3, 2)
    torch.save(saved.state_dict(), tmp_path / "policy.pt")
    network.load_state_dict(read_weights(tmp_path / "policy.pt", network.state_dict()))
    torch.testing.assert_close(network(torch.ones(3)), saved(torch.ones(3)), rtol=0, atol=0)


def test_another_network_is_named_by_the_first_shape_that_differs(tmp_path):
    torch.save(nn.Linear(4, 2).state_dict(), tmp_path / "policy.pt")
    with pytest.raises(ValueError, match="restore"):
        read_weights(tmp_path / "policy.pt", nn.Linear(3, 2).state_dict())
    with pytest.raises(ValueError, match="bias"):
        read_weights(tmp_path / "policy.pt", nn.Linear(4, 2, bias=False).state_dict())


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK half of one"])
def test_a_damaged_file_gets_one_line(tmp_path, content):
    (tmp_path / "policy.pt").write_bytes(content)
    with pytest.raises(ValueError, match="restore"):
        read_weights(tmp_path / "policy.pt", {})


@pytest.mark.parametrize("more", [0, 1])
def test_a_file_may_unpack_to_eight_times_the_weights_and_a_megabyte_and_to_no_more(tmp_path, more):
    file, network = tmp_path / "policy.pt", nn.Linear(300, 200)
    torch.save(network.state_dict(), file)
    with zipfile.ZipFile(file, "a") as archive:
        held = sum(entry.file_size for entry in archive.infolist())
        archive.writestr("policy/padding", bytes(8 * 4 * (300 * 200 + 200) + 1_000_000 - held + more))
    if more:
        with pytest.raises(ValueError, match="unpacks"):
            read_weights(file, network.state_dict())
    else:
        assert read_weights(file, network.state_dict()).keys() == {"weight", "bias"}


@pytest.mark.parametrize("kind", ["meta", "sparse", "list"])
def test_what_is_no_tensor_of_numbers_in_memory_is_no_weight(tmp_path, kind):
    network = nn.Linear(3, 2)
    given = {"meta": torch.empty(2, 3, device="meta"), "sparse": torch.eye(3)[:2].to_sparse(), "list": [[0.0] * 3] * 2}
    torch.save({**network.state_dict(), "weight": given[kind]}, tmp_path / "policy.pt")
    with pytest.raises(ValueError, match="restore"):
        read_weights(tmp_path / "policy.pt", network.state_dict())
