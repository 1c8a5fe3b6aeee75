"""The filter against the textbook's on a linear plant, and against the true plant where measurements are exact."""

import math

import pytest
import torch
from plants import A, B, Linear, Plant, spring

from dynasindy.control import Observer
from dynasindy.control.observer import CANDIDATES, Belief
from dynasindy.envs import ControlEnv, Sensors, Step, Tracking, TrackingReward
from dynasindy.findings import FindingError
from dynasindy.systems import Diverged, Signature, System, Tras, integrate

DT = 0.05
SCALE = torch.tensor(spring().signature.x_scale, dtype=torch.float64)

TASK = Tracking(spring().signature, Step([[0.0]]), ["p"], ["v"], TrackingReward([1.0]))


def held(seconds, a=A, b=B):
    """F and G of x+ = F x + G u after some seconds, by the exponential of [[A, B], [0, 0]]."""
    n, m = b.shape
    whole = torch.zeros(n + m, n + m, dtype=torch.float64)
    whole[:n] = torch.cat([a, b], 1)
    both = torch.linalg.matrix_exp(whole * seconds)
    return both[:n, :n], both[:n, n:]


def observer(q=1e-2, delay=0.0, substeps=10, **sensors):
    channels = {"p": {"noise": 0.02}, "m": {"noise": 0.01, "resolution": 0.01}}
    sensors = Sensors(**({"channels": channels} | sensors))
    model = spring()
    model.delay = delay
    made = Observer(model, sensors, ControlEnv(spring(), TASK, DT, substeps))
    made.q, made.nis = torch.full((3,), q, dtype=torch.float64), 1.0
    return made


def logged(steps, seed=0, lost=0.0, q=0.0):
    """A noisy log of the linear plant, with process noise q, and its true states."""
    rng = torch.Generator().manual_seed(seed)
    f, g = held(DT)
    u = 2 * torch.rand(steps, 1, generator=rng, dtype=torch.float64) - 1
    x = [torch.zeros(3, dtype=torch.float64)]
    for k in range(steps):
        push = q * SCALE * math.sqrt(DT) * torch.randn(3, generator=rng, dtype=torch.float64)
        x.append(f @ x[-1] + g @ u[k] + push)
    x = torch.stack(x)
    y = x + torch.tensor([0.02, 0.0, 0.01]) * torch.randn(x.shape, generator=rng, dtype=torch.float64)
    y[torch.rand(len(y), generator=rng) < lost] = math.nan
    y[:, 1] = math.nan
    return y, u, x


def textbook(y, u, q, first):
    """The Kalman filter as in any book, one measurement vector after the other, for x+ = F x + G u + w."""
    f, g = held(DT)
    noise, x, p = torch.diag((q * SCALE) ** 2 * DT), *first
    c = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    r = torch.diag(torch.tensor([0.02**2, 0.01**2 + 0.01**2 / 12], dtype=torch.float64))
    means, surprises = [], []
    for k in range(len(u)):
        x, p = f @ x + g @ u[k], f @ p @ f.T + noise
        v = y[k + 1, [0, 2]] - c @ x
        if not v.isnan().any():
            s = c @ p @ c.T + r
            gain = p @ c.T @ torch.linalg.inv(s)
            x, p = x + gain @ v, p - gain @ s @ gain.T
            surprises.append((v @ torch.linalg.inv(s) @ v).item() / 2)
        else:
            surprises.append(math.nan)
        means.append(x)
    return torch.stack(means), p, torch.tensor(surprises, dtype=torch.float64)


def test_on_a_linear_plant_it_is_the_textbooks_filter_with_lost_samples_too():
    ours, (y, u, _) = observer(), logged(80, lost=0.2)
    first = ours.begin(y[0])
    means, nis, _ = ours.follow(y, u)
    theirs, covariance, surprises = textbook(y, u, 1e-2, (first.mean, first.covariance))
    torch.testing.assert_close(means[1:], theirs, rtol=0, atol=1e-7)
    torch.testing.assert_close(nis, surprises, rtol=1e-5, atol=0, equal_nan=True)
    assert nis.isnan().any() and not nis.isnan().all()
    belief = first
    padded = torch.cat([torch.zeros(ours.memory, 1, dtype=torch.float64), u])
    for k in range(80):
        belief, _, _ = ours.correct(ours.advance(belief, padded[k + 1 : k + 1 + ours.memory]), y[k + 1])
    torch.testing.assert_close(belief.covariance, covariance, rtol=1e-6, atol=1e-12)


def test_smoothed_states_are_the_likeliest_by_all_measurements():
    """On a linear plant those are the least squares of all innovations, noises and first states at once."""
    ours, (y, u, _) = observer(), logged(40, lost=0.2)
    first, (f, g) = ours.begin(y[0]), held(DT)
    noises = (1e-2 * SCALE * math.sqrt(DT)).repeat(40)
    seen = y.clone()
    seen[0] = math.nan  # the first belief has it
    places, count = (~seen.flatten().isnan()).nonzero().flatten(), 41 * 3
    sizes = ours.variance.sqrt().repeat(41)[places]
    moves = torch.zeros(40 * 3, count, dtype=torch.float64)
    for k in range(40):
        moves[3 * k : 3 * k + 3, 3 * k : 3 * k + 6] = torch.cat([-f, torch.eye(3, dtype=torch.float64)], 1)
    start, sensors = torch.eye(3, count, dtype=torch.float64), torch.eye(count, dtype=torch.float64)[places]
    deviations = first.covariance.diagonal().sqrt()
    rows = [start / deviations[:, None], moves / noises[:, None], sensors / sizes[:, None]]
    values = [first.mean / deviations, (u @ g.T).flatten() / noises, seen.flatten()[places] / sizes]
    theirs = torch.linalg.lstsq(torch.cat(rows), torch.cat(values)).solution.reshape(41, 3)
    torch.testing.assert_close(ours.smooth(y, u), theirs, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("delay", "late"), [(0.0, 0), (0.05, 0), (0.07, 0), (0.0, 2), (0.07, 2), (0.1, 1)])
def test_without_noise_it_is_where_the_plant_will_be_when_the_next_input_arrives(delay, late):
    """The plant gets its inputs `delay` seconds late, the observer its measurements `late` periods later."""
    rng = torch.Generator().manual_seed(3)
    u = torch.cat([torch.zeros(10, 1), 2 * torch.rand(60, 1, generator=rng) - 1]).double()
    pieces, (f, g) = 5, held(DT / 5)
    shift = round(delay / DT * pieces)
    x = [torch.zeros(3, dtype=torch.float64)]
    for k in range(len(u) * pieces):
        x.append(f @ x[-1] + g @ (u[(k - shift) // pieces] if k >= shift else u[0]))
    x = torch.stack(x)
    ours = observer(delay=delay, channels={"p": {}, "v": {}, "m": {}})
    ours.sensors = Sensors({"p": {}, "v": {}, "m": {}}, delay=late)
    arrived = torch.cat([x[:1].expand(late, -1), x[::pieces]])[: len(u) + 1]
    belief = ours.begin(arrived[0])
    padded = torch.cat([torch.zeros(ours.memory, 1, dtype=torch.float64), u])
    for k in range(len(u)):
        inputs = padded[k + 1 : k + 1 + ours.memory]
        belief, _, _ = ours.correct(ours.advance(belief, inputs), arrived[k + 1])
        now = (k + 1) * pieces + shift
        if now < len(x):
            torch.testing.assert_close(ours.ahead(belief.mean, inputs), x[now], rtol=0, atol=1e-7)


def test_an_estimated_push_moves_its_rate_and_stays():
    ours = observer(rates={"p": "v"}, disturbance=True)
    ours.q = torch.full((4,), 1e-2, dtype=torch.float64)
    pushed = torch.zeros(4, 4, dtype=torch.float64)
    pushed[:3, :3], pushed[1, 3] = A, 1.0
    x = torch.tensor([0.1, -0.2, 0.3, 0.5], dtype=torch.float64)
    moved = ours.advance(Belief(x, torch.eye(4, dtype=torch.float64)), torch.zeros(ours.memory, 1))
    torch.testing.assert_close(moved.mean, torch.linalg.matrix_exp(pushed * DT) @ x, rtol=0, atol=1e-7)


class TorchTras(Tras):
    """The same equations without machine code."""

    machine_code = False


@pytest.mark.parametrize("learnt", [False, True])
def test_machine_code_believes_what_torch_code_believes(learnt):
    sensors = Sensors({name: {"noise": 0.01} for name in Tras().signature.state_names[:4]}, delay=1)
    beliefs = []
    for plant in (Tras(), TorchTras()):
        ours = Observer(plant, sensors, ControlEnv(plant, Tracking(plant.signature, Step([[0.0, 0.0]])), DT))
        ours.nis = 1.0 if learnt else None
        rng = torch.Generator().manual_seed(0)
        belief = ours.begin(0.1 * torch.randn(3, 6, generator=rng))
        belief = Belief(belief.mean + 0.1 * torch.randn(belief.mean.shape, generator=rng), belief.covariance)
        inputs = torch.rand(3, ours.memory, 2, generator=rng)
        beliefs.append([*vars(ours.advance(belief, inputs)).values(), ours.ahead(belief.mean, inputs)])
    torch.testing.assert_close(*beliefs, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("q", [1e-2, 5e-2])
def test_the_process_noise_is_found_that_the_innovations_show(q):
    ours, (y, u, x) = observer(substeps=1), logged(1000, q=q)
    estimates = ours.learn(y, u)
    assert 0.5 * q < ours.q[0].item() < 2 * q and ours.nis == pytest.approx(1.0, abs=0.15)
    assert ours.learnt and ours.system is ours.model and estimates.shape == x.shape
    assert (estimates - x)[:, 0].std() < 0.75 * 0.02


def test_a_plant_that_is_pushed_is_believed_to_move_at_its_rates():
    # Pushes act on v and m alone: p stays the integral of v, and v is seen through p without noise of its own.
    rng, q = torch.Generator().manual_seed(3), 0.3
    f, g = held(DT / 10)
    u = 2 * torch.rand(400, 1, generator=rng, dtype=torch.float64) - 1
    x = [torch.zeros(3, dtype=torch.float64)]
    for k in range(400):
        push = torch.randn(10, 3, generator=rng, dtype=torch.float64) * torch.tensor([0, 1, 1]) * q * SCALE
        x.append(x[-1])
        for part in push * math.sqrt(DT / 10):
            x[-1] = f @ x[-1] + g @ u[k] + part
    x = torch.stack(x)
    y = x + torch.tensor([0.02, 0.0, 0.01]) * torch.randn(x.shape, generator=rng, dtype=torch.float64)
    y[:, 1] = math.nan
    ours, alike = observer(rates={"p": "v"}, substeps=1), observer(substeps=1)
    estimates, others = ours.learn(y, u), alike.learn(y, u)
    assert ours.q[0] < 0.01 * q and 0.5 * q < ours.q[1].item() < 2 * q and ours.q[1] == ours.q[2]
    assert (estimates - x)[:, 1].std() < 0.9 * (others - x)[:, 1].std()


def test_a_perfect_model_is_doubted_a_little():
    y, u, _ = logged(200)
    ours = observer()
    ours.learn(y, u)
    assert ours.q.tolist() == [CANDIDATES[0].item()] * 3


def test_before_there_is_a_model_rates_are_those_of_the_latest_angles():
    ours = observer(channels={"p": {"resolution": 0.001}, "m": {}}, rates={"p": "v"})
    ours.nis = None
    fresh = Observer(ours.model, ours.sensors, ControlEnv(spring(), TASK, DT))
    t = torch.arange(60, dtype=torch.float64) * DT
    angle, speed = 0.3 * torch.sin(3 * t), 0.9 * torch.cos(3 * t)
    y = torch.stack([(angle / 0.001).round() * 0.001, torch.full_like(t, math.nan), t], -1)
    means, _, _ = fresh.follow(y, torch.zeros(59, 1))
    assert (means[5:, 0] - angle[5:]).abs().max() < 2e-3
    assert (means[5:, 1] - speed[5:]).abs().max() < 0.25  # a line through angles 0.05 s apart lags by some 0.1
    assert (means[:, 2] - t).abs().max() < 1e-6


class Stores(System):
    """Two heat stores: x' = (y - x) / 5, y' = (x - y) / 20 at rest alone; y has no sensor."""

    @property
    def followers(self):
        return {1: 0}

    def __init__(self):
        super().__init__(Signature(("x", "y"), ("K", "K"), ("u",), (100.0, 100.0)))

    def forward(self, x, u):
        flow = (x[..., :1] - x[..., 1:]) * torch.tensor([-1 / 5, 1 / 20]).to(x)
        return flow + torch.nn.functional.pad(u, (0, 1)).to(x)


def test_a_state_that_follows_begins_at_what_it_follows_and_a_lost_sample_tells_nothing():
    plant = Stores()
    task = Tracking(plant.signature, Step([[0.0]]), ["x"], [], TrackingReward([1.0]))
    made = Observer(plant, Sensors({"x": {"noise": 0.5}}, disturbance=True), ControlEnv(plant, task, 1.0))
    belief = made.begin(torch.tensor([[80.0, math.nan], [math.nan, math.nan]]))
    assert belief.mean.tolist() == [[80.0, 80.0, 0.0], [0.0, 0.0, 0.0]]
    # A tenth of the range for what is not measured; the noise of what is.
    assert belief.covariance[0].diagonal()[:2].tolist() == pytest.approx([0.25, 100.0])
    made.nis = 1.0
    still = made.advance(belief, torch.zeros(2, made.memory, 1)).mean[0]
    assert still[:2].tolist() == pytest.approx([80.0, 80.0])  # at rest nothing flows


def test_what_no_plant_can_do_counts_as_lost_in_its_row_and_its_state_is_doubted():
    ours, (y, u, _) = observer(), logged(40)
    belief = ours.begin(y[0])
    for k in range(30):
        belief, _, _ = ours.correct(ours.advance(belief, u[: ours.memory]), y[k + 1])
    rows = y[31].repeat(5, 1)
    rows[:, 0] = torch.tensor([belief.mean[0], math.nan, 1e38, -1e200, math.inf])
    after, nis, _ = ours.correct(Belief(belief.mean.expand(5, -1), belief.covariance.expand(5, -1, -1)), rows)
    assert after.mean[0, 1] != after.mean[1, 1] and nis.isfinite().all()
    for row in (2, 3, 4):
        assert torch.equal(after.mean[row], after.mean[1]) and nis[row] == nis[1]
    more = (after.covariance - after.covariance[1]).diagonal(dim1=-2, dim2=-1)
    assert more[2].tolist() == more[3].tolist() == pytest.approx([0.1**2, 0.0, 0.0]) and not more[4].any()


def test_a_plant_that_is_truly_far_away_is_believed_from_its_second_sample():
    """A sensor of p begins anew and says 60 more from then on, which would be lost for ever if nothing was doubted."""
    ours, (y, u, x) = observer(), logged(60)
    y[20:, 0] += 60.0
    means = ours.follow(y, u)[0]
    assert (means - x)[20, 0].abs() < 0.2 and (means - x)[22, 0] == pytest.approx(60.0, abs=5.0)


def test_a_place_that_a_measurement_confirms_may_be_thousands_of_ranges_away():
    ours, (y, _, _) = observer(), logged(60)
    far = 3000.0 * float(ours.scale[0])
    belief, y = ours.begin(y[0]), y[1].clone()
    belief.mean[0], y[0] = far, far + 0.01
    after = ours.correct(belief, y)[0]
    assert float(after.mean[0]) == pytest.approx(far, abs=0.02)


def test_a_model_that_explodes_costs_no_estimate():
    ours = observer()
    ours.model.forward = lambda x, u: torch.full_like(x, torch.inf)
    before = ours.begin(torch.tensor([0.3, math.nan, 0.1]))
    after = ours.advance(before, torch.zeros(ours.memory, 1))
    assert torch.equal(after.mean, before.mean) and after.covariance.isfinite().all()
    assert (after.covariance.diagonal() > before.covariance.diagonal()).all()
    assert torch.equal(ours.ahead(before.mean, torch.zeros(ours.memory, 1)), before.mean)


def test_a_covariance_that_cannot_be_solved_ends_the_run_in_a_word_of_ours():
    ours = observer()
    n = len(ours.scale)
    belief = Belief(torch.zeros(n).double(), torch.full((n, n), 2.0**100).double())  # a reciprocal that is exact
    with pytest.raises(Diverged, match="observer"):
        ours.correct(belief, torch.zeros(ours.n_x))


def test_the_slope_of_a_nonlinear_plant_is_that_of_autograd():
    plant = Tras()
    sensors = Sensors({name: {} for name in plant.signature.state_names})
    ours = Observer(plant, sensors, ControlEnv(plant, Tracking(plant.signature, Step([[0.0, 0.0]])), DT, 5))
    ours.q, ours.nis = torch.zeros(6, dtype=torch.float64), 1.0
    x = torch.tensor([0.1, -0.2, 0.3, 0.2, 900.0, 1500.0], dtype=torch.float64)
    u = torch.tensor([0.1, 0.3], dtype=torch.float64)
    f = torch.autograd.functional.jacobian(lambda x: integrate(plant, x, u, DT, 5)[0][-1], x)
    eye = torch.eye(6, dtype=torch.float64)
    moved = ours.advance(Belief(x, eye), u.expand(ours.memory, 2))
    scaled = torch.diag(1 / ours.scale)
    torch.testing.assert_close(scaled @ moved.covariance @ scaled, scaled @ f @ f.T @ scaled, rtol=1e-6, atol=1e-9)


def test_what_was_learnt_is_restored_and_what_is_none_is_refused():
    ours, again, (y, u, _) = observer(), observer(), logged(50)
    again.nis = None
    ours.learn(y, u)
    again.load_state_dict(ours.state_dict())
    assert torch.equal(again.q, ours.q) and again.nis == ours.nis and again.learnt
    for wrong in ([1.0], [1.0, 0.0, 1.0], [1.0, -1.0, 1.0], [1.0, math.nan, 1.0]):
        with pytest.raises(ValueError, match=r"process noise > 0 .* 3"):
            again.load_state_dict({"process_noise": wrong, "nis": 1.0})


def test_a_model_in_discrete_time_is_filtered_as_in_the_textbook():
    """The same plant as its exact difference equation, (F - 1) / dt and G / dt: what is in between does not matter."""

    class Sampled(Linear):
        step = DT

    f, g = held(DT)
    ours, (y, u, _) = observer(), logged(60, lost=0.2)
    ours.model = Sampled((f - torch.eye(3)) / DT, g / DT, spring().signature.x_scale, "pvm")
    first = ours.begin(y[0])
    theirs = textbook(y, u, 1e-2, (first.mean, first.covariance))[0]
    torch.testing.assert_close(ours.follow(y, u)[0][1:], theirs, rtol=0, atol=1e-7)
    ours.dt = 1.5 * DT
    with pytest.raises(ValueError, match=r"0\.05 s .* 0\.075 s"):
        ours.follow(y, u)


def test_a_model_that_no_observer_can_follow_is_refused():
    """Errors grow by exp(800 x 0.05) a period: beyond what double precision has digits for."""
    plant = Plant("a b", lambda a, b, u: [800 * b + u, 800 * a + u])
    sensors = Sensors({"a": {"noise": 0.1}, "b": {"noise": 0.1}})
    task = Tracking(plant.signature, Step([[0.0]]), ["a"], [None], TrackingReward([1.0]))
    rng = torch.Generator().manual_seed(0)
    with pytest.raises(FindingError) as error:
        Observer(plant, sensors, ControlEnv(plant, task, DT, 20)).learn(
            torch.randn(40, 2, generator=rng, dtype=torch.float64), torch.rand(39, 1, generator=rng).double()
        )
    assert error.value.finding.code == "observer.lost" and error.value.finding.values["states"] == ("a", "b")
