"""Every option of every group composes and its parts are built."""

import copy
import math
import re
from functools import cache

import pytest
import torch
from configs import CONF, composed, make_parts
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import OmegaConf
from settings import require_trusted

from dynasindy.dyna.excite import excite
from dynasindy.planning import Gate

GROUPS = ("system", "task", "excitation", "world_model", "planning", "agent", "sensors", "scenario", "experiment")
OPTIONS = [f"{group}={file.stem}" for group in GROUPS for file in sorted((CONF / group).glob("[a-z]*.yaml"))]
PLANTS = sorted({file.stem for file in (CONF / "system").glob("[a-z]*.yaml")} - {"logged", "black_box"})
"""The plants of the folder, to which whoever uses the package may have added some of their own."""


@cache
def build(*overrides):
    cfg = composed("train", *overrides)
    return cfg, make_parts(cfg)


@pytest.mark.parametrize("option", sorted(set(OPTIONS) - {"system=logged", "system=black_box"}))  # without equations
def test_every_option_is_built_and_admitted_in_the_folder_of_a_run(option):
    cfg, _ = build(option)
    require_trusted(OmegaConf.to_container(cfg, resolve=False))


def test_the_environment_of_the_page_is_built_of_its_own_words(tmp_path):
    page = (CONF.parent / "docs" / "gymnasium.md").read_text()
    (block,) = re.findall(r"`my_conf/system/my_env.yaml`\n\n```yaml\n(.*?)```", page, re.S)
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "my_env.yaml").write_text(block)
    cfg = composed("train", "system=my_env", f"hydra.searchpath=[file://{tmp_path}]")
    assert list(cfg.world_model.library) == ["1", "p", "v", "omega", "force", "sin(theta)", "cos(theta)"]
    assert (cfg.env.dt, cfg.task.outputs, cfg.task.reference.high) == (0.04, ["p", "theta"], [0.3, 0.0])


def test_a_task_without_targets_is_flown_as_it_draws_episodes():
    cfg, parts = build("system=gymnasium", "task=own")
    assert cfg.scenario.name == "task" and parts.plant.task.own
    assert parts.plant.task.starts.shape == (256, 3)
    assert parts.plant.task.library.names[-2:] == ("w^2", "torque^2")


@pytest.mark.parametrize("experiment", ["paper", "dyna", "gradient", "smoke"])
def test_without_planning_no_experiment_imagines_anything(experiment):
    _, parts = build(f"experiment={experiment}", "planning=none")
    assert parts.planner.plan().imagined == 0 and not parts.planner.due(1)


EXAMPLES = CONF.parent / "docs" / "examples"


def test_plants_that_stay_are_excited_by_the_whole_signal_at_once():
    rows, again = excite(build("system=tras")[1]), build.__wrapped__("system=tras")[1]
    with torch.no_grad():
        wanted = again.env.rollout(200, again.excitation)  # the bare signal, from the first period to the last
    for key in ("state", "action", ("next", "state")):
        assert torch.equal(rows[key], wanted[key])


def test_a_plant_of_which_nobody_says_that_it_stays_is_moved_little_at_first():
    _, parts = build("system=pendulum", "~plant.first", "experiment=smoke")
    assert parts.excitation.first == 0.1


@pytest.mark.parametrize(
    ("words", "first"),
    [
        (["rig=udp"], 0.1),
        (["rig=udp", "excitation=chirp", "plant.first=0.02"], 0.1),
        (["rig=udp", "~plant.first"], 0.1),
        (["rig=udp", "excitation=aprbs", "excitation.first=1.0"], 1.0),
        (["rig=simulated"], 1.0),
    ],
)
def test_a_rig_that_is_really_there_is_moved_little_at_first_whatever_the_file_of_its_plant_says(words, first):
    cfg = composed("rig", "system=tras", *words)
    assert cfg.plant.get("first") == {"plant.first=0.02": 0.02, "~plant.first": None}.get(words[-1], 1.0)
    assert instantiate(cfg.excitation, _convert_="all")(n_u=2, dt=0.05).first == first


def test_a_rehearsal_has_the_bounds_and_the_start_of_its_plant():
    words = ["system=pendulum", "+plant.bounds={theta: 2.0}", "+plant.start={theta: [0.1, 0.5]}"]
    given, bare = (instantiate(composed("rig", *w).rig, _convert_="all") for w in (words, words[:1]))
    assert (given.keywords["bounds"], given.keywords["start"]) == ({"theta": 2.0}, {"theta": [0.1, 0.5]})
    assert bare.keywords["bounds"] == bare.keywords["start"] == {}


@pytest.mark.parametrize(
    ("system", "period", "samples"), [("tras", 0.05, 5), ("xi", 0.05, 5), ("tanks", 2.0, 5), ("reactor", 3.0, 40)]
)
def test_a_recording_of_a_plant_has_its_pace(system, period, samples):
    words = [f"system={system}", f"hydra.searchpath=[file://{EXAMPLES / 'conf'}]", "sensors=bench"]
    data = composed("identify", *words[: 3 if system in ("tras", "xi") else 2]).data
    found = instantiate(data, _convert_="all")
    assert (found.period, found.samples, found.dt, found.validation_seconds) == (period, samples, None, None)
    assert (found.sensors is None) == (system not in ("tras", "xi"))


@pytest.fixture(scope="module")
def default_setting():
    return OmegaConf.to_container(composed("ablation", "setting=rollouts_800"), resolve=False)


@pytest.mark.parametrize("setting", sorted(file.stem for file in (CONF / "setting").glob("*.yaml")))
def test_every_setting_of_the_ablation_differs_from_its_default_in_what_it_names(setting, default_setting):
    cfg = OmegaConf.to_container(composed("ablation", f"setting={setting}"), resolve=False)
    text = (CONF / "setting" / f"{setting}.yaml").read_text()
    changed = {key for key in cfg if cfg[key] != default_setting[key]}
    assert changed <= {line.partition(":")[0] for line in text.splitlines()} | {"world_model"}
    assert bool(changed) == (setting != "rollouts_800")


@pytest.mark.parametrize("system", [plant for plant in PLANTS if plant != "gymnasium"])
def test_a_bench_measures_what_the_file_of_the_plant_says(system):
    if not composed("train", f"system={system}").plant.get("sensors"):
        pytest.skip(f"{system} names no sensors, so it has no bench")
    cfg, parts = build(f"system={system}", "sensors=bench_delay", "experiment=smoke")
    observer = parts.sensing.observer
    measured = [name for name, r in zip(parts.plant.system.signature.state_names, observer.variance) if r < torch.inf]
    assert sorted(measured) == sorted(cfg.plant.sensors)
    assert observer.sensors.actuator_delay


@pytest.mark.parametrize("system", ["tras", "trms33", "xi"])
def test_the_twin_rotors_have_the_bench_of_a_real_one(system):
    # Encoders of 4096 counts per turn, noise of 20 rpm on the speeds.
    sensors = OmegaConf.to_container(composed("train", f"system={system}").plant.sensors)
    count = pytest.approx(2 * math.pi / 4096, rel=1e-6)
    assert sensors == {
        **{angle: {"resolution": count, "noise": 0.0} for angle in ("alpha_a", "alpha_p")},
        **{speed: {"resolution": 0.0, "noise": 20.0} for speed in ("omega_a", "omega_p")},
    }


def test_a_plant_without_a_bench_is_told_how_to_give_one():
    with pytest.raises(InstantiationException, match=r"sensors\.channels .* plant\.sensors"):
        build("sensors=bench", "~plant.sensors")


@pytest.mark.parametrize("command", ["train", "identify", "rig", "evaluate", "ablation"])
def test_each_group_of_a_plant_without_what_may_be_left_out_resolves_by_itself(command, tmp_path):
    """Hydra resolves the group that it builds, and what that group copies of others, wherever defaults stand there."""
    (tmp_path / "system").mkdir()
    lines = (
        "# @package _global_",
        "system: {_target_: dynasindy.systems.Pendulum}",
        "plant: {outputs: [theta], low: [-1.0], high: [1.0], library: polynomial, amplitude: [0.5], offset: [0.0],",
        "  sensors: {theta: {resolution: 0.001}}}",
    )
    (tmp_path / "system" / "mine.yaml").write_text("\n".join(lines))
    sensors = ["sensors=bench"] if command in ("train", "rig") else []
    words = [*(["system=mine"] if command != "evaluate" else []), f"hydra.searchpath=[file://{tmp_path}]", *sensors]
    cfg = composed(command, *words)
    groups = [name for name in cfg if OmegaConf.is_dict(cfg._get_node(name)) and "_target_" in cfg[name]]
    assert command == "evaluate" or groups
    for name in groups:
        group = copy.deepcopy(cfg[name])
        group._set_parent(cfg)
        group._set_flag(["allow_objects", "struct", "readonly"], [True, False, False])  # as Hydra does
        OmegaConf.resolve(group)


def test_the_excitation_of_the_default_is_a_thousand_samples():
    cfg, parts = build()
    assert parts.excitation.n_steps * cfg.env.substeps == 1000
    assert parts.model_env.log_dt == pytest.approx(0.01)


@pytest.mark.parametrize("signal", ["multisine", "aprbs"])
def test_runs_over_seeds_do_not_share_their_random_excitation(signal):
    one, again, other = (
        build.__wrapped__(f"excitation={signal}", f"seed={s}")[1].excitation.samples() for s in (1, 1, 2)
    )
    assert (one == again).all() and not (one == other).all()


def test_the_gate_of_the_library_is_that_of_the_default():
    gate = instantiate(composed("train").gate)
    assert vars(gate) == vars(Gate())


@pytest.mark.parametrize(
    ("command", "override", "key", "value"),
    [
        ("rig", "planner={updates: 5}", "planner", {"updates": 5}),
        ("rig", "guard.high={theta: 1.0}", "guard.high", {"theta": 1.0}),
        ("rig", "guard.low={theta: -1.0}", "guard.low", {"theta": -1.0}),
        ("train", "plant.known={angle: rate}", "plant.known", {"angle": "rate"}),
    ],
)
@pytest.mark.parametrize("sign", ["", "+"])
def test_keys_of_ones_own_are_given_as_documented(command, override, key, value, sign):
    given = ["system=logged"] if command == "train" else []
    cfg = composed(command, *given, sign + override)
    assert OmegaConf.select(cfg, key) == value
