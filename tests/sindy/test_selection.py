"""Selection on a triangular factor equals selection by refitting."""

import itertools

import pytest
import torch

from dynasindy.sindy.regression import least_missed, reconsider, walk_down
from dynasindy.sindy.sensitivity import Parameters


def _problem(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    columns = torch.randn(60, 5, generator=generator, dtype=torch.float64)
    target = columns[:, :1] - 2 * columns[:, 2:3] + 0.1 * torch.randn(60, 1, generator=generator, dtype=torch.float64)
    return columns, target


def _squared(columns: torch.Tensor, target: torch.Tensor) -> float:
    return float((target - columns @ torch.linalg.pinv(columns) @ target).square().sum())


def _triangle(*parts: torch.Tensor) -> torch.Tensor:
    return torch.linalg.qr(torch.cat(parts, -1), mode="r")[1]


def test_the_least_missed_column_is_the_one_whose_refit_costs_least():
    columns, target = _problem()
    costs = [
        _squared(columns[:, [k for k in range(5) if k != j]], target) - _squared(columns, target) for j in range(5)
    ]
    j, growth = least_missed(_triangle(columns, target), 5)
    assert j == min(range(5), key=costs.__getitem__)
    assert growth == pytest.approx(min(costs))


def test_walking_down_ends_at_the_best_subset_of_its_size():
    columns, target = _problem()
    kept, values = walk_down(_triangle(columns, target) / 0.1, torch.ones(5, dtype=torch.bool), 12.0)
    best = min(itertools.combinations(range(5), 2), key=lambda s: _squared(columns[:, list(s)], target))
    assert tuple(kept.tolist()) == best == (0, 2)
    assert torch.allclose(values, (torch.linalg.pinv(columns[:, [0, 2]]) @ target).squeeze(-1))


def test_columns_that_are_not_removable_stay():
    columns, target = _problem()
    kept, _ = walk_down(_triangle(columns, target) / 0.1, torch.tensor([True, False, True, True, True]), 1e9)
    assert kept.tolist() == [1]


def test_a_missed_function_is_taken_in():
    columns, target = _problem()
    active = Parameters(torch.tensor([0, 1]), torch.tensor([0, 0]))
    others = Parameters(torch.tensor([2, 3]), torch.tensor([0, 0]))
    better = reconsider(_triangle(columns[:, [0, 1, 2, 3]], target) / 0.1, 0, active, others, 5.0)
    assert better.tolist() == [0, 1, 2]


def test_three_functions_that_imitate_one_are_exchanged_for_it():
    """alpha, alpha cos(alpha), alpha^2 sin(alpha) imitate sin(alpha) at small angles."""
    a = torch.linspace(-0.3, 0.3, 200, dtype=torch.float64)
    columns = torch.stack([a, a * a.cos(), a**2 * a.sin(), a.sin()], -1)
    active = Parameters(torch.tensor([0, 1, 2]), torch.tensor([0, 0, 0]))
    others = Parameters(torch.tensor([3]), torch.tensor([0]))
    better = reconsider(_triangle(columns, columns[:, 3:]) / 1e-6, 0, active, others, 5.0)
    assert better.tolist() == [3]


def test_nothing_better_is_said_so():
    columns, target = _problem()
    active = Parameters(torch.tensor([0, 2]), torch.tensor([0, 0]))
    others = Parameters(torch.tensor([1, 3]), torch.tensor([0, 0]))
    assert reconsider(_triangle(columns[:, [0, 2, 1, 3]], target) / 0.1, 0, active, others, 20.0) is None


def diagonal(*targets: float, rest: float = 1.0) -> torch.Tensor:
    """Orthonormal columns: dropping one costs the square of its target."""
    n = len(targets)
    column = torch.tensor([*targets, rest], dtype=torch.float64).unsqueeze(-1)
    return torch.cat([torch.eye(n + 1, n, dtype=torch.float64), column], -1)


def test_a_column_stays_if_it_costs_as_much_as_the_limit():
    for value, kept in ((3.0, [0, 1, 2]), (2.99, [0, 2])):
        found, values = walk_down(diagonal(5.0, value, -4.0), torch.ones(3, dtype=torch.bool), 9.0)
        assert found.tolist() == kept
        assert values.tolist() == pytest.approx([{0: 5.0, 1: value, 2: -4.0}[k] for k in kept])


def test_a_dependent_column_goes_for_nothing_unless_it_must_stay():
    triangle = diagonal(5.0, 3.0)
    triangle[1, 1] = 1e-14
    assert least_missed(triangle, 2) == (1, 0.0)
    assert least_missed(triangle, 2, torch.tensor([True, False]))[0] == 0
    assert least_missed(triangle, 0) == (-1, float("inf"))
    assert least_missed(triangle, 2, torch.zeros(2, dtype=torch.bool)) == (-1, float("inf"))


def test_a_function_comes_in_if_it_is_worth_twice_the_limit_the_best_of_each_equation():
    active = Parameters(torch.tensor([0]), torch.tensor([0]))
    others = Parameters(torch.tensor([1, 2, 1, 2]), torch.tensor([0, 0, 1, 1]))
    # Squared errors 9 and 16 in the first equation, 8.1 and 7.9 in the second; the start state is always there.
    triangle = diagonal(1.0, 5.0, 3.0, 4.0, 8.1**0.5, 7.9**0.5)
    assert reconsider(triangle, 1, active, others, 4.0).tolist() == [0, 2, 3]
    assert reconsider(triangle, 1, active, others, 4.1).tolist() == [0, 2]
    assert reconsider(triangle, 1, active, others, 8.1) is None


def exchange(states: list[int], n_fixed: int = 0) -> list[int] | None:
    """Three functions whose sum is the target, and the sum itself outside the model."""
    n = 3 + n_fixed
    columns = torch.eye(n + 2, n + 1, dtype=torch.float64)
    columns[:, n] = 0.0
    columns[n_fixed:n, n] = 1.0
    columns[n, n] = 1e-3
    target = 10.0 * columns[:, n : n + 1].clone()
    target[n] = 0.0
    target[:n_fixed] = 7.0
    active = Parameters(torch.tensor([0, 1, 2]), torch.tensor(states))
    others = Parameters(torch.tensor([3]), torch.tensor([0]))
    better = reconsider(_triangle(columns, target), n_fixed, active, others, 1.0)
    return None if better is None else better.tolist()


def test_three_functions_are_exchanged_for_one_whichever_equations_they_are_of():
    for states in ([0, 0, 0], [0, 0, 1], [0, 1, 1]):
        assert exchange(states) == exchange(states, n_fixed=2) == [3]


def test_an_exchange_one_for_one_is_within_an_equation():
    """The target is the sum of what is outside and of the second function; the first one nearly is what is outside."""
    columns = torch.eye(4, dtype=torch.float64)
    columns[:, 2] = columns[:, 0] + 0.01 * columns[:, 3]
    target = 10 * (columns[:, 2:3] + columns[:, 1:2])
    others = Parameters(torch.tensor([2]), torch.tensor([0]))
    for states, found in (([0, 1], [1, 2]), ([1, 0], None)):
        active = Parameters(torch.tensor([0, 1]), torch.tensor(states))
        better = reconsider(_triangle(columns[:, :3], target) / 0.04, 0, active, others, 5.0)
        assert (better if better is None else better.tolist()) == found


def test_a_parameter_that_stays_and_has_no_effect_is_zero_and_changes_nothing_else():
    columns, target = _problem()
    with_idle = torch.cat([0 * columns[:, :1], columns], -1)
    removable = torch.tensor([False, *[True] * 5])
    kept, values = walk_down(_triangle(with_idle, target), removable, 4.0)
    alone, expected = walk_down(_triangle(columns, target), removable[1:], 4.0)
    assert kept.tolist() == [0, *(alone + 1).tolist()] and float(values[0]) == 0
    torch.testing.assert_close(values[1:], expected)
