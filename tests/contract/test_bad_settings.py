"""A bad setting costs exit code 2 and one line that names it, before any work, and leaves nothing behind."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CONF = ROOT / "conf"
GROUPS = sorted({file.parent.relative_to(CONF).as_posix() for file in CONF.glob("*/**/*.yaml")})
TASK = ["plant.outputs=[theta]", "plant.low=[-0.6]", "plant.high=[0.6]"]


@pytest.mark.parametrize("group", GROUPS)
def test_a_misspelt_option_of_any_group(refused, tmp_path, group):
    name = {"rig": "rig", "setting": "ablation"}.get(group, "train")
    options = sorted(file.stem for file in (CONF / group).glob("*.yaml") if not file.stem.startswith("_"))
    line = refused(name, f"{group}={options[0]}x", cwd=tmp_path)
    assert f"'{group}'" in line and f"'{options[0]}x'" in line
    assert all(option in line for option in options)


@pytest.mark.parametrize(
    ("key", "given"),
    [
        ("seed", "x"),
        ("seed", "9" * 40),
        ("threads", "1000000"),
        ("device", "tpu"),
        ("env.dt", "-0.05"),
        ("env.dt", "SECONDS"),
        ("env.substeps", "0"),
        ("gate", "null"),
        ("excitation.duration", "nan"),
        ("agent.hidden", "400"),
        ("agent.gamma", "1.5"),
        ("planning.rollouts", "-5"),
        ("replay.capacity", "0"),
        ("task.outputs", "[yaw,alpha_p]"),
        ("task.max_steps", "0"),
        ("world_model.library", "nothing"),
        ("system._target_", "no.such"),
        ("evaluation.every", "0"),
        ("checkpoint.every", "-1"),
        ("scenario.episodes", "0"),
    ],
)
def test_a_bad_value_of_any_part(refused, tmp_path, key, given):
    """One of each kind; tests/scripts/test_schema.py has more of them."""
    line = refused("train", "experiment=smoke", "planning=dyna", f"{key}={given}", cwd=tmp_path)
    assert key.rpartition(".")[2].strip("_") in line or given.strip("[]") in line


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("planning.rolouts", "'rollouts'"),
        ("duration", "'excitation.duration'"),
        ("checkpoint.xyz", "every"),
    ],
)
def test_a_key_that_does_not_exist(refused, tmp_path, key, meant):
    planning = ["planning=dyna"] if key.endswith("rolouts") else []
    line = refused("train", *planning, f"{key}=1", cwd=tmp_path)
    assert f"'{key.rpartition('.')[2]}'" in line and meant in line


@pytest.mark.parametrize("words", [["planning.lrr=3", "seed=0,1"], ["-m", "seed=0,1", "planning.lrr=3", "sead=1"]])
def test_the_first_of_several_mistakes_of_a_sweep(refused, tmp_path, words):
    assert "'lrr'" in refused("train", *words, cwd=tmp_path)


def test_several_values_without_a_sweep(refused, tmp_path):
    assert "-m" in refused("train", "experiment=smoke", "seed=0,1", cwd=tmp_path)


@pytest.mark.parametrize("words", [["plant.outputs=[yaw"], ["system=tras", "system"], ["system=logged"]])
def test_words_that_cannot_be_read_or_name_no_plant_to_train_on(refused, tmp_path, words):
    assert words[-1] in refused("train", *words, cwd=tmp_path)


@pytest.mark.parametrize(
    ("words", "key"),
    [
        ([], "plant.outputs"),
        ([*TASK, "planning=dyna"], "planning"),
        ([*TASK, "evaluation.within=0"], "evaluation.within"),
        ([*TASK, "env.dt=-1.0"], "env.dt"),
        (["plant.outputs=[theta]", "plant.low=[-0.6]"], "plant.high"),
        (["plant.outputs=[thta]", *TASK[1:]], "'thta'"),
        ([*TASK, "plant.start={omega: 0}"], "plant.start"),
        ([*TASK, "plant.library=['1',u,'sinh(theta)']"], "'sinh'"),
        ([*TASK, "data.path=nowhere.csv"], "nowhere.csv"),
        ([*TASK, "data.dt=-1"], "data.dt is -1"),
        ([*TASK, "system=pendulum", "model=model.json"], "model"),
        (["-m", *TASK, "data.path=nowhere.csv", "seed=0,1"], "nowhere.csv"),
    ],
)
def test_what_is_missing_or_wrong_where_a_log_is_planned_from(refused, log, tmp_path, words, key):
    path = [] if any(word.startswith("data.path") for word in words) else [f"data.path={log}"]
    assert key in refused("train", *words, "data=csv", *path, cwd=tmp_path)


@pytest.mark.parametrize(
    ("name", "words", "key"),
    [
        ("identify", ["data=csv", "data.path=FILE"], "FILE"),
        ("identify", ["sensors=bench", "data=csv", "data.path=log.csv"], "sensors"),
        ("identify", ["system=tras", "plant.library=['1',u_a,'sinh(alpha_a)']", "excitation.duration=10000"], "'sinh'"),
        ("evaluate", [], "run"),
        ("evaluate", ["run=nowhere"], "nowhere"),
        ("evaluate", ["run=nowhere", "formats=[onnx]"], "formats"),
        ("check", ["run=FOLDER"], "FOLDER"),
        ("check", ["run=FOLDER", "grid=1"], "grid"),
        ("export", ["run=PATH"], "PATH"),
        ("export", ["run=PATH", "formats=[png]"], "formats"),
        ("export", ["run=PATH", "fmi=1"], "fmi"),
        ("report", ["save=nowhere"], "nowhere"),
        ("table", [], "folder"),
        ("ablation", ["setting=direct,oracle", "planning.updatez=3"], "'updatez'"),
        ("ablation", ["experiment=smoke", "hydra/launcher=basic", "level.error=-1"], "level"),
        ("ablation", ["experiment=smoke", "hydra/launcher=basic", "device=tpu"], "device"),
    ],
)
def test_a_bad_setting_of_any_other_command(refused, tmp_path, name, words, key):
    assert key in refused(name, *words, cwd=tmp_path)


@pytest.mark.parametrize(
    ("word", "key"),
    [
        ("targets=[[1,2,3]]", "targets"),
        ("targets=[[30.0]]", "plant.low"),
        ("seconds=-1", "seconds"),
        ("flights=0", "seconds"),
        ("guard.late=-1", "late"),
        ("guard.low={thta: -1}", "'thta'"),
        ("planner={update: 100}", "'update'"),
        ("rig=udp rig.host=ADDRESS", "rig.host"),
    ],
)
def test_a_bad_setting_of_a_rig_before_anything_moves(command, tmp_path, word, key):
    done = command("rig", "system=pendulum", "folder=run", *word.split(maxsplit=word.count("=") - 1), cwd=tmp_path)
    lines = done.err.splitlines()
    assert done.code == 2 and len(lines) == 1 and key in lines[0]
    assert not list(tmp_path.rglob("*.csv"))


def test_a_file_of_the_user_with_a_slip_is_named_with_its_line(command, tmp_path):
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "arm.yaml").write_text("# @package _global_\nplant: {low: [0.1}\n")
    done = command("rig", "--config-dir", str(tmp_path), "system=arm", "folder=run", cwd=tmp_path)
    assert done.code == 2 and "arm.yaml, line 2" in done.err and done.err.count("\n") == 1


def test_a_folder_that_is_a_file(refused, log, tmp_path):
    (tmp_path / "here").write_text("a file")
    line = refused("train", "data=csv", f"data.path={log}", *TASK, f"folder={tmp_path}/here/run", cwd=tmp_path)
    assert "here/run" in line and (tmp_path / "here").read_text() == "a file"


def test_a_command_that_does_not_exist(tmp_path):
    words = [sys.executable, "-m", "dynasindy", "trian"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "'trian'" in done.stderr and "'train'" in done.stderr
