import pytest
import torch

from dynasindy.systems.twin_rotor import SIGNATURE, beam_stops, two_branches


def test_default_stops_are_those_of_the_vendors_simulation():
    beyond = torch.tensor([[7.0, 2.0, 1.0, 3.0, 4e3, 2e3]], dtype=torch.float64)
    held = torch.tensor([[6.0, 1.5708, 0.0, 0.0, 4e3, 2e3]], dtype=torch.float64)
    for side in (1, -1):
        torch.testing.assert_close(beam_stops().apply(side * beyond)[0], side * held, rtol=0, atol=1e-4)


def test_states_and_inputs_are_the_papers_in_its_order():
    assert SIGNATURE.state_names == ("alpha_a", "alpha_p", "Omega_a", "Omega_p", "omega_a", "omega_p")
    assert SIGNATURE.state_units == ("rad", "rad", "rad/s", "rad/s", "rpm", "rpm")
    assert SIGNATURE.input_names == ("u_a", "u_p")
    assert SIGNATURE.x_scale == (1, 1, 1, 1, 4000, 2500)  # about half of the bench's top speeds
    assert (SIGNATURE.n_x, SIGNATURE.n_u) == (6, 2)


def test_a_rotors_branch_is_chosen_by_its_sense_in_full_precision():
    w = torch.tensor([-2.0, 0.0, 3.0], dtype=torch.float64)
    chosen = two_branches(w, 1.4971e-5, 8.9974e-6)
    assert chosen.dtype == torch.float64
    assert chosen.tolist() == pytest.approx([8.9974e-6, 1.4971e-5, 1.4971e-5], rel=1e-14)
