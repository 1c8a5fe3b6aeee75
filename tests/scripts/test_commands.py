"""The commands of dynasindy: which there are, what they imply, and what they leave where something is wrong."""

import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import forked
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

ROOT = Path(__file__).resolve().parents[2]
HEAVY = {"torch", "torchrl", "tensordict", "pysindy", "scipy", "sympy", "matplotlib"}


@pytest.fixture
def cli(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    import cli

    return cli


def dynasindy(*words, cwd, **environment):
    command = [sys.executable, "-m", "dynasindy", *words]
    return forked.run(command, cwd=cwd, env={**os.environ, **environment})


def test_every_command_is_a_script_with_a_main_and_every_config_belongs_to_one(cli):
    for name in cli.COMMANDS:
        text = (ROOT / "scripts" / f"{name}.py").read_text()
        assert re.search(r"^(def main\(|main = command\()", text, re.M), name
        assert 'if __name__ == "__main__":\n    main()\n' in text, name
        assert f"`python scripts/{name}.py " in text  # what the help and the manual show
    assert {file.stem for file in (ROOT / "conf").glob("*.yaml")} <= set(cli.COMMANDS)


@pytest.mark.parametrize("words", [[], ["--help"]])
def test_without_a_command_all_of_them_are_listed(cli, words, tmp_path):
    done = dynasindy(*words, cwd=tmp_path)
    listed = re.findall(r"^  (\w+)  +\S", done.stdout, re.M)
    assert done.returncode == 0 and tuple(listed) == cli.COMMANDS


EVERY_HELP = """
import contextlib, io, runpy, sys
for name in {names}:
    sys.argv = [f"{scripts}/{{name}}.py", "--help"]
    with contextlib.redirect_stdout(io.StringIO()) as page, contextlib.suppress(SystemExit):
        runpy.run_path(sys.argv[0], run_name="__main__")
    assert f"python {scripts}/{{name}}.py" in page.getvalue(), name  # which runs from here, too
print(*sys.modules)
"""


def test_no_help_imports_what_takes_seconds(cli, tmp_path):
    code = EVERY_HELP.format(names=cli.COMMANDS, scripts=ROOT / "scripts")
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'scripts'}"}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert not {"hydra", "numpy", *HEAVY} & set(done.stdout.split())
    assert not list(tmp_path.iterdir())


def test_a_wrong_key_is_found_before_torch_is_imported(tmp_path):
    code = "import sys; sys.argv = ['train', 'sed=1']\nimport train\ntry: train.main()\nfinally: print(*sys.modules)"
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'scripts'}"}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == 2 and "'seed'" in done.stderr
    assert not HEAVY & set(done.stdout.split())


@pytest.mark.slow
def test_each_command_has_all_that_it_imports_in_a_process_of_its_own(tmp_path):
    """But for `train` and `identify`, whose whole runs in a process of their own are tests of other files."""
    short = ("scenario.episodes=2", "task.max_steps=60", "excitation.duration=3", "folder=run")
    made = dynasindy("train", "experiment=gradient_smoke", "system=pendulum", *short, cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    shutil.copytree(tmp_path / "run", tmp_path / "results" / "runs" / "mine")
    calls = (
        ("evaluate", "run=run", "scenarios=[step]", "formats=[svg]", "animate=true"),
        ("check", "run=run", "points=1", "grid=2", "draws=1", "seconds=1"),
        ("export", "run=run", "formats=[c,model]"),
        ("report", "results=results"),
        ("rig", "system=pendulum", "controller=run/controller.json", "sensors=exact", "seconds=0.2", "guard.late=100"),
    )
    for words in calls:
        command = [sys.executable, "-m", "dynasindy", *words]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode in ((0, 1) if words[0] == "check" else (0,)), (words, done.stderr)
        assert "Traceback" not in done.stderr, (words, done.stderr)


@pytest.fixture
def words(monkeypatch):
    """Return the module that reads the words of a command line."""
    monkeypatch.syspath_prepend(ROOT / "scripts")
    import command

    return command


@pytest.mark.parametrize("options", [[], ["--config-dir", "own"], ["--config-dir=own"]])
def test_settings_stand_before_options_with_those_that_are_implied(words, options, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = ["plant.outputs=[a]", "model=a.json"]
    assert words.read_words("train", [*options, *given]) == [*given, "system=logged", *options]
    assert words.read_words("train", [given[0], *options, given[1]]) == [*given, "system=logged", *options]


def test_a_sweep_has_the_folder_of_its_settings_wherever_its_options_stand(words):
    setting, folder, *options = words.read_words("train", ["-m", "seed=0,1", "--config-dir", "own"])
    assert setting == "seed=0,1" and options == ["-m", "--config-dir", "own"]
    assert folder.startswith("hydra.sweep.dir='runs/seed-0-1_")
    two = words.read_words("train", ["-m", "experiment=smoke", "seed=0,1"])[2]
    assert two == "hydra.sweep.dir='runs/experiment-smoke-seed-0-1_fef842'"  # a later version goes on with it
    assert words.read_words("train", ["seed=0,1", "-m"])[1] == folder
    assert words.read_words("train", ["-m", "seed=0,2"])[1] != folder
    assert words.read_words("train", ["-m"])[0].startswith("hydra.sweep.dir=")
    mine = ["seed=0,1", "hydra.sweep.dir=mine", "-m"]
    assert words.read_words("train", mine) == mine


def test_folders_of_jobs_leave_out_what_all_jobs_share_where_a_disk_would_not_take_their_names(words):
    library = f"plant.library=[{','.join(f'x{k}' for k in range(60))}]"
    given = words.read_words("train", ["-m", library, "seed=0,1"])
    assert "hydra.job.config.override_dirname.exclude_keys=[plant.library]" in given
    assert not any("exclude_keys" in word for word in words.read_words("train", ["-m", "system=xi", "seed=0,1"]))


def test_a_run_that_is_resumed_keeps_its_folder(words, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"config\.yaml"):
        words.read_words("train", [f"resume={tmp_path}"])
    (tmp_path / "config.yaml").touch()
    line = words.read_words("train", [f"resume={tmp_path}", "--config-dir", "own"])
    assert line == [f"resume={tmp_path}", f"hydra.run.dir='{tmp_path}'", "--config-dir", "own"]


def test_a_setting_that_no_file_of_its_plant_gives_is_added_and_no_other(words):
    given = ["system=pendulum", "plant.low=[-1]", "+plant.start={theta: 1}", "seed=1"]
    # A key in a mapping is new, too; that the class of a plant has an argument is seen to when its module is imported.
    added = ["plant.bounds={theta: 2}", "plant.known={Omega: theta}", "system.mass=2"]
    assert words.read_words("train", [*given, *added]) == [*given, *(f"++{word}" for word in added)]
    with pytest.raises(ValueError, match=r"'plant\.low' does not exist"):
        words.read_words("export", ["plant.low=[1]"])


@pytest.mark.parametrize(
    ("word", "read"),
    [
        ("data.time=Time [ms]", {"data.time": "Time [ms]"}),
        ("data.time=Zeit (s)", {"data.time": "Zeit (s)"}),
        ("data.states=[T [degC], h (m)]", {"data.states": ["T [degC]", "h (m)"]}),
        ("data.states=['T [degC]',h]", {"data.states": ["T [degC]", "h"]}),
        ("plant.low=[-0.5,1]", {"plant.low": [-0.5, 1]}),
    ],
)
def test_a_heading_with_brackets_is_text_though_the_shell_took_its_quotation_marks(words, word, read):
    key, _, value = word.partition("=")
    (found,) = OverridesParser.create().parse_overrides([f"{key}={words.as_text(value)}"])
    assert {found.key_or_group: found.value()} == read


def unread(*arguments, cwd):
    """Run Python with an output that has lost its reader before the first line; return exit code and stderr."""
    ours = [sys.executable, *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "scripts")}
    with subprocess.Popen(
        ours, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=cwd, env=environment
    ) as process:
        process.stdout.close()
        error = process.stderr.read()
    return process.returncode, error


def test_an_output_that_nobody_reads_ends_a_script_quietly_and_an_error_is_told(tmp_path):
    code = "import sys\nfrom cli import pipe_guard\nwith pipe_guard():\n    print('read me')\n    sys.exit(0)"
    assert unread("-c", code, cwd=tmp_path) == (141, "")
    code = "from cli import pipe_guard\nwith pipe_guard():\n    raise RuntimeError('the plant')"
    status, error = unread("-c", code, cwd=tmp_path)
    assert status == 1 and "RuntimeError: the plant" in error


def test_a_pipe_that_is_not_the_output_breaks_loudly(tmp_path):
    code = "from cli import pipe_guard\nwith pipe_guard():\n    raise BrokenPipeError('a worker died')"
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "scripts")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.returncode == 1 and "a worker died" in done.stderr


@pytest.mark.parametrize(
    ("words", "said", "before"),
    [
        (["planning.learning_rate=1,2"], "'learning_rate'", False),
        (["system=pendulum,nothing"], "'nothing'", True),
        (["seed=range(0,0)"], "no job", True),
        (["seed=0,1", "threads=many"], "threads", False),
    ],
)
def test_a_sweep_that_is_refused_leaves_nothing_and_takes_nothing_away(tmp_path, words, said, before):
    sweep = tmp_path / "runs" / "mine"
    if before:  # an earlier sweep in this folder
        (sweep / "0_seed-0").mkdir(parents=True)
        (sweep / "multirun.yaml").write_text("{}")
    done = forked.call("train", "-m", "hydra.sweep.dir=runs/mine", *words, cwd=tmp_path)
    assert done.returncode == 2 and said in done.stderr
    left = ["runs", "runs/mine", "runs/mine/0_seed-0", "runs/mine/multirun.yaml"] if before else []
    assert [str(path.relative_to(tmp_path)) for path in sorted(tmp_path.rglob("*"))] == left


def run(*overrides, cwd, **more):
    return forked.call("train", *overrides, cwd=cwd, env=os.environ | more)


def test_a_group_without_a_file_is_told_and_not_the_file_of_a_user(tmp_path):
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "mine.yaml").write_text((ROOT / "conf" / "system" / "pendulum.yaml").read_text())
    done = run("--config-dir", str(tmp_path), "system=mine", "sensors=null", cwd=tmp_path)
    assert done.returncode == 2 and "'null'" in done.stderr and "'sensors'" in done.stderr


def test_several_values_without_a_sweep_say_how_to_ask_for_one(tmp_path):
    done = run("experiment=smoke", "seed=0,1", cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert "'seed=0,1'" in done.stderr and "--multirun" in done.stderr and done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("argv", [[], ["td4"]])
def test_unknown_benchmark_gets_one_line_that_names_the_known_ones(argv):
    done = subprocess.run([sys.executable, ROOT / "scripts" / "benchmark.py", *argv], capture_output=True, text=True)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "gradient" in done.stderr and "rigs" in done.stderr and "common" not in done.stderr
    assert (argv[0] if argv else "none") in done.stderr


def test_the_saved_runs_of_the_repository_name_no_machine() -> None:
    files = list((ROOT / "docs" / "results" / "runs").rglob("*"))
    texts = {file: file.read_text() for file in files if file.is_file()}
    assert not [
        str(file) for file, text in texts.items() if any(word in text for word in ("/tmp", "/root", "/home", "/work"))
    ]
    assert not [str(file) for file in files if file.suffix in (".pt", ".png")]


def test_only_jobs_of_the_present_command_are_counted(tmp_path):
    earlier = tmp_path / "runs" / "ablation" / "xi" / "smoke" / "direct"
    for name in ("other", "agent.critics-0"):
        (earlier / name / "seed_1").mkdir(parents=True)
        (earlier / name / "seed_1" / "error.txt").write_text("error: earlier\n")
    words = ("experiment=smoke", "system=xi", "setting=direct", "seed=1", "results=results", "agent.critics=1,0")
    done = forked.call("ablation", *words, "hydra/launcher=basic", cwd=tmp_path, timeout=600)
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 2 and last.startswith("error: 2 ")
    assert re.findall(r"direct/(\S+?)/seed_1", last) == ["agent.critics-0", "agent.critics-1"]
    assert (earlier / "other" / "seed_1" / "error.txt").read_text() == "error: earlier\n"


def test_the_file_of_the_page_is_a_rig_that_only_a_connection_is_missing_of(tmp_path):
    page = (ROOT / "docs" / "rig.md").read_text()
    (block,) = re.findall(r"`my_rig/system/arm.yaml`\n\n```yaml\n(.*?)```", page, re.S)
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "arm.yaml").write_text(block)
    words = ["--config-dir", str(tmp_path), "system=arm", f"folder={tmp_path}/run"]
    done = forked.call("rig", *words)
    assert done.returncode == 2
    assert "angle within -1.5 to 1.5 rad" in done.stdout and "rig=udp" in done.stderr


LOGGED = {"data": {"_target_": "dynasindy.identification.identify.LoggedData", "path": "log.csv"}, "system": None}


@pytest.mark.parametrize("settings", [LOGGED, {"rig": {"_target_": "dynasindy.rig.udp.connect"}}])
def test_a_run_without_a_simulated_plant_says_that_there_is_none_to_fly(tmp_path, settings):
    settings = {**settings, "plant": {"outputs": ["theta"]}}
    (tmp_path / "config.yaml").write_text(OmegaConf.to_yaml(settings))
    (tmp_path / "metrics.json").write_text("{}")
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(ROOT / "scripts" / "evaluate.py"), f"run={tmp_path}"]
    done = forked.run(command, env=environment, timeout=300)
    assert done.returncode == 2
    assert f"python scripts/check.py run={tmp_path}" in done.stderr


def test_a_job_of_a_sweep_is_done_again_if_its_log_is_another_one(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    import saved_run

    file, run = tmp_path / "log.csv", tmp_path / "run"
    run.mkdir()
    cfg = OmegaConf.create({"model": None, "data": {"path": str(file)}})
    file.write_text("time,y,u\n")
    read = saved_run._digests(cfg)
    assert read[str(file)] == hashlib.sha256(b"time,y,u\n").hexdigest()
    (run / "origin.json").write_text(json.dumps({"command": "train.py", "read": read}))
    assert saved_run._finished(run, read) is False  # it has forecast nothing yet
    (run / "metrics.json").write_text('{"prediction": {"controlled": true}}')
    assert saved_run._finished(run, read) is True
    assert saved_run._finished(run, saved_run._digests(OmegaConf.merge(cfg, {"seed": 1}))) is False
    file.write_text("time,y,u\n0,1,2\n")
    assert saved_run._finished(run, saved_run._digests(cfg)) is False


@pytest.fixture
def steps(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    monkeypatch.setattr(sys, "argv", ["scripts/train.py"])
    import cli

    return cli


@pytest.fixture
def improvements(steps):
    import saved_run

    return saved_run.improvements


def read(line):
    """Return what a shell makes of a command."""
    return shlex.split(line, comments=True)


@pytest.mark.parametrize(
    ("words", "keys", "kept"),
    [
        (["data=csv", "data.path=my log.csv", "folder=x"], ["folder"], ["data=csv", "data.path=my log.csv"]),
        (["excitation=aprbs", "data.noise=0.1", "formats=[pdf]"], ["data", "formats"], ["excitation=aprbs"]),
        (["+plant.bounds={z: 1}", "hydra/launcher=basic"], ["hydra"], ["+plant.bounds={z: 1}"]),
        (["plant.known={q: w}", "+plant.start={q: 1}"], ["plant.known"], ["+plant.start={q: 1}"]),
    ],
)
def test_words_are_left_out_by_key_or_group_and_a_shell_gives_the_others_back(steps, words, keys, kept):
    assert steps.without(words, *keys) == kept
    assert read(steps.command_line("identify", kept, "does it")) == ["python", "scripts/identify.py", *kept]


def test_a_command_has_the_folder_of_the_users_settings(steps, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["scripts/rig.py", "--config-dir", "my rig", "system=arm"])
    line = steps.command_line("rig", ["system=arm"])
    assert read(line)[1:] == ["scripts/rig.py", "--config-dir", "my rig", "system=arm"]
    evaluate, check = steps.run_steps("a run", "evaluate", "check")
    assert read(evaluate)[1:] == ["scripts/evaluate.py", "--config-dir", "my rig", "run=a run"]
    assert read(check)[1] == "scripts/check.py"


def test_a_plant_that_is_not_controlled_is_offered_a_look_and_more_episodes_but_no_export(improvements):
    words = ["system=xi", "train.episodes=2", "folder=runs/a b", "hydra.run.dir=x"]
    head, check, more = improvements("runs/a b", words, 2).split("\n")
    assert head == "next:" and read(check) == ["python", "scripts/check.py", "run=runs/a b"]
    assert read(more)[2:] == ["system=xi", "hydra.run.dir=x", "train.episodes=4"]
    for smoke in ("experiment=smoke", "experiment=gradient_smoke"):
        tried = improvements("a", ["system=xi", smoke, "train.episodes=2", "seed=3"], 2).split("\n")
        assert read(tried[2])[2:] == ["system=xi", "seed=3", "train.episodes=4"]
    assert improvements("a", ["resume=a"], 2).count("\n") == 1  # a run that goes on takes no other settings
    (_, more) = improvements("a", ["system=xi"], 1, checked=False, longer="plans longer").split("\n")
    assert "system=xi planning.updates=" in more and "train.episodes" not in more  # the model is not what fails
    (_, _, more) = improvements("a", ["data.path=log.csv"], longer="plans longer").split("\n")
    assert "planning.updates=" in more and "identify" not in more
    (_, more) = improvements("a", [], 1, checked=False).split("\n")
    assert read(more)[2:] == ["train.episodes=3"]


def test_a_plan_from_a_log_that_does_not_hold_is_offered_what_the_log_lacks(improvements):
    words = ["data=csv", "data.path=my log.csv", "plant.outputs=[angle]", "system=tras", "planning.lr=1"]
    words.append("plant.known={angle: rate}")
    _, check, identify = improvements("a", words).split("\n")
    assert "check.py run=a" in check
    assert read(identify) == ["python", "scripts/identify.py", *(w for w in words if not w.startswith("planning"))]
    assert "identify" not in improvements("a", ["model=model.json"])
    (_, alone) = improvements("a", words, lacking=True).split("\n")  # a check would ask the model that lacks something
    assert read(alone) == read(identify)
    (_, alone) = improvements("a", ["system=xi", "seed=3"], 1, lacking=True).split("\n")
    assert read(alone) == ["python", "scripts/identify.py", "system=xi"]
