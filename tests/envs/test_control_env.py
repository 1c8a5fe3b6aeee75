import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from dynasindy.envs import ControlEnv
from dynasindy.systems import Pendulum, Tras, Xi, integrate
from dynasindy.tasks import RandomStep, Tracking, TrackingReward


def make(system=None, **settings):
    system = system or Tras()
    task = Tracking(system.signature, RandomStep([-0.5, -0.5], [0.5, 0.4]), max_steps=settings.pop("max_steps", 400))
    return ControlEnv(system, task, **settings)


class Constant:
    def __init__(self, *u):
        self.u = torch.tensor(u)

    def __call__(self, tensordict):
        return tensordict.set("action", self.u.expand(*tensordict.batch_size, len(self.u)))


@pytest.mark.parametrize("batch_size", [(), (4,)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("system", [Tras, Xi])
def test_specs_hold(system, dtype, batch_size):
    check_env_specs(make(system(), dtype=dtype, batch_size=batch_size))


@pytest.mark.parametrize(("dtype", "batch_size"), [(torch.float32, ()), (torch.float64, (4,))])
def test_specs_hold_for_one_input(dtype, batch_size):
    system = Pendulum()
    reward = TrackingReward(error_weights=(1.0,))
    task = Tracking(system.signature, RandomStep([-1.0], [1.0]), ("theta",), ("Omega",), reward)
    check_env_specs(ControlEnv(system, task, dtype=dtype, batch_size=batch_size))


def test_a_period_is_the_integrators_and_its_samples_are_logged():
    env = make(dtype=torch.float64)
    rollout = env.rollout(3, Constant(0.2, 0.4))
    x = torch.zeros(6, dtype=torch.float64)
    u = torch.tensor([0.2, 0.4]).double()
    expected, _ = integrate(Tras(), x, u, 0.15, 15)
    assert torch.allclose(rollout["next", "samples"].reshape(15, 6), expected)
    assert torch.equal(rollout["next", "samples"][:, -1], rollout["next", "state"])


def test_episodes_are_truncated_and_never_terminated():
    rollout = make(max_steps=5).rollout(100, Constant(1.0, 1.0))
    assert rollout.shape == (5,)
    assert rollout["next", "truncated"][:, 0].tolist() == [False] * 4 + [True]
    assert not rollout["next", "terminated"].any()


def test_the_beam_rests_at_its_stop_and_says_so():
    rollout = make(dtype=torch.float64).rollout(400, Constant(1.0, 1.0))
    touched = rollout["next", "at_stop"]
    pitch, rate = rollout["next", "state"][:, 1], rollout["next", "state"][:, 3]
    assert touched.any() and not touched[0]
    assert pitch.max() == torch.pi / 2
    assert (rate[pitch == torch.pi / 2] <= 0).all()


def test_partial_reset_leaves_the_other_rows():
    env = make()
    after = env.rollout(3, Constant(0.3, 0.3), auto_reset=False, tensordict=env.reset(TensorDict(batch_size=[3])))
    ongoing = env.step_mdp(after[:, -1])
    mask = torch.tensor([[False], [True], [False]])
    reset = env.reset(ongoing.clone().set("_reset", mask), select_reset_only=True, set_state=False)
    assert reset["step_count"].flatten().tolist() == [3, 0, 3]
    assert torch.equal(reset["state"][[0, 2]], ongoing["state"][[0, 2]])
    assert (reset["state"][1] == 0).all()
    assert not torch.equal(reset["task_params"][1], ongoing["task_params"][1])


def test_the_same_seed_draws_the_same_references():
    def references(seed):
        env = make()
        env.set_seed(seed)
        return torch.stack([env.reset()["reference"] for _ in range(3)])

    assert torch.equal(references(3), references(3))
    assert not torch.equal(references(3), references(4))
    assert references(3).unique(dim=0).shape[0] == 3  # a fresh reference every episode


def test_batched_and_single_physics_agree():
    env = make(dtype=torch.float64)
    start = torch.randn(5, 6, dtype=torch.float64) * 0.1
    batch = env.rollout(4, Constant(0.1, 0.3), auto_reset=False, tensordict=env.start_from(start))
    single = env.rollout(4, Constant(0.1, 0.3), auto_reset=False, tensordict=env.start_from(start[2]))
    assert torch.equal(batch["next", "state"][2], single["next", "state"])


def test_real_equals_imagined_under_the_true_model():
    env = make(dtype=torch.float64)
    imagined = env.with_system(Tras())
    starts = env.reset(TensorDict(batch_size=[2]))
    rollouts = [e.rollout(50, Constant(0.3, 0.9), auto_reset=False, tensordict=starts.clone()) for e in (env, imagined)]
    for key in ("state", "observation", "reward", "at_stop", "reference"):
        assert torch.equal(rollouts[0]["next", key], rollouts[1]["next", key]), key


def test_a_model_of_another_plant_is_refused():
    with pytest.raises(ValueError, match="2 states and 1 inputs, the environment 6 and 2"):
        make().with_system(Pendulum())


def test_the_step_is_differentiable():
    u = torch.tensor([[0.1, 0.2]], requires_grad=True)
    samples, _ = make().advance(torch.zeros(1, 6), u)
    samples[:, -1, 5].sum().backward()
    # One period of 6100 rpm/s per unit of u_p, less the drag of the rotor.
    assert u.grad[0, 1].item() == pytest.approx(6100 * 0.05, rel=0.02)


@pytest.mark.parametrize("settings", [{"dt": -0.05}, {"substeps": 0}, {"dt": float("nan")}])
def test_impossible_times_are_refused(settings):
    with pytest.raises(ValueError, match="need dt > 0 s and substeps >= 1"):
        make(**settings)


class Broken(Pendulum):
    """A plant that returns what a function makes of the right rates of change."""

    def __init__(self, change):
        super().__init__()
        self.change = change

    def forward(self, x, u):
        return self.change(super().forward(x, u))


def around(system, **settings):
    reward = TrackingReward(error_weights=(1.0,))
    task = Tracking(system.signature, RandomStep([-1.0], [1.0]), ("theta",), ("Omega",), reward, max_steps=400)
    return ControlEnv(system, task, **settings)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda dx: dx[..., :1], r"returned \(2, 1\) of torch\.float32; it has to return \(2, 2\) of torch\.float32"),
        (lambda dx: dx.sum(), r"returned \(\) of torch\.float32"),
        (lambda dx: dx.double(), r"returned \(2, 2\) of torch\.float64"),
        (lambda dx: dx.tolist(), r"returned a list; it has to return \(2, 2\)"),
        (lambda dx: dx * torch.tensor([1.0, torch.nan]), r"not finite, of Omega, where episodes begin"),
        (lambda dx: dx[..., 5], r"system Broken failed \(IndexError"),
    ],
)
def test_a_system_that_gives_no_rates_of_change_is_refused_at_once(change, said):
    with pytest.raises(ValueError, match=said) as error:
        around(Broken(change)).check_plant()
    assert "\n" not in str(error.value)


def test_an_episode_that_memory_cannot_hold_is_refused_before_it_begins():
    with pytest.raises(ValueError, match=r"400 periods \(task\.max_steps\) with 1000000000 samples each .* GB"):
        around(Pendulum(), substeps=10**9)
