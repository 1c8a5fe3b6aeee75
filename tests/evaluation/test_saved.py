import csv
import json
from pathlib import Path

import pytest

from dynasindy.evaluation.saved import _origin_without_machine, keep_run, to_save


def write(path: Path, header: str, rows) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    times = [round(0.05 * k, 2) for k in range(400)]
    header = "time [s],y [rad],v [rad/s],u [-],reference_y [rad]"
    for name in ("data/step_response", "evaluation/step", "evaluation/sine"):
        write(folder / f"{name}.csv", header, [[t, 0.123456789, 2, 3, 0.5] for t in times])
    write(folder / "data/excitation.csv", header, [[t, 1, 2, 3, 0] for t in times[:200]])
    write(
        folder / "data/prediction_last_episode.csv",
        "time,y,v,predicted_y,predicted_v",
        [[t, 1, 2, 1, 2] for t in times],
    )
    write(folder / "progress.csv", "episode,return,evaluated_return", [[k, -1e6 / k, ""] for k in range(1, 1201)])
    (folder / "metrics.json").write_text('{"seed": 0}')
    (folder / "config.yaml").write_text(
        "seed: 0\nfolder: /tmp/x/run\nresults: docs/results\ntrain:\n  path: /etc/x\n  n: 1\n"
    )
    (folder / "policy.pt").write_bytes(b"weights")
    (folder / "origin.json").write_text(json.dumps({"command": "x", "commit": "abc1234"}))
    (folder / "evaluation/step.json").write_text('{"rmse": 0.1}')
    return folder


def test_the_copy_is_small_and_holds_no_weights_and_no_place(run, tmp_path):
    target = tmp_path / "docs" / "kept"
    files = {file.relative_to(target).as_posix() for file in keep_run(run, target)}
    assert files == {
        "config.yaml", "origin.json", "metrics.json", "progress.csv", "data/step_response.csv", "data/excitation.csv",
        "data/prediction_last_episode.csv", "evaluation/sine.csv", "evaluation/step.json",
    }  # fmt: skip
    assert (target / "config.yaml").read_text() == "seed: 0\ntrain:\n  n: 1\n"
    assert json.loads((target / "origin.json").read_text()) == {"command": "x", "commit": "abc1234"}


def test_tables_over_time_are_thinned_evenly(run, tmp_path):
    keep_run(run, tmp_path / "kept")
    sine = read(tmp_path / "kept/evaluation/sine.csv")
    assert sine[0]["y [rad]"] == "0.12346"
    assert [row["time [s]"] for row in sine[:3]] == ["0.0", "0.2", "0.4"] and sine[-1]["time [s]"] == "19.8"
    step = read(tmp_path / "kept/data/step_response.csv")
    assert step[1]["time [s]"] == "0.1"
    assert len(read(tmp_path / "kept/data/excitation.csv")) == 200
    assert len(read(tmp_path / "kept/data/prediction_last_episode.csv")) == 200


def test_a_log_of_episodes_keeps_its_ends_and_whole_numbers(run, tmp_path):
    keep_run(run, tmp_path / "kept")
    rows = read(tmp_path / "kept/progress.csv")
    assert (rows[0]["episode"], rows[-1]["episode"]) == ("1", "1200") and 240 <= len(rows) <= 260
    assert {int(b["episode"]) - int(a["episode"]) for a, b in zip(rows[1:], rows[2:])} == {5}
    assert rows[0]["return"] == "-1000000.0" and rows[0]["evaluated_return"] == ""


def test_what_the_model_saw_is_left_out_on_demand(run, tmp_path):
    files = {file.name for file in keep_run(run, tmp_path / "kept", model=False)}
    assert "excitation.csv" not in files and "step_response.csv" in files
    assert {path.name for path in tmp_path.iterdir()} == {"run", "kept"}


def test_a_run_that_knows_its_command_is_believed_without_its_paths(run, tmp_path):
    command = "python scripts/train.py system=xi folder=runs/x hydra.run.dir=/tmp/x data.path=/data/log.csv seed=1"
    (run / "origin.json").write_text(json.dumps({"command": command, "commit": "def"}))
    assert _origin_without_machine(run) == {"command": "python scripts/train.py system=xi seed=1", "commit": "def"}
    keep_run(run, tmp_path / "kept")
    assert json.loads((tmp_path / "kept" / "origin.json").read_text())["commit"] == "def"


def test_the_first_seed_of_the_settings_that_are_meant_is_saved_under_its_place(tmp_path):
    for place in (
        "xi/dyna/a/seed_0",
        "xi/dyna/a/seed_1",
        "xi/dyna/b/seed_0",
        "tras/paper/a/seed_0",
        "xi/dyna/c/seed_0",
    ):
        (tmp_path / place).mkdir(parents=True)
        if "/c/" not in place:  # c did not end
            (tmp_path / place / "metrics.json").touch()
    found = to_save(tmp_path, None, 0, ["a", "c"])
    assert {run.relative_to(tmp_path).as_posix(): name for run, name in found.items()} == {
        "xi/dyna/a/seed_0": "xi_dyna_a",
        "tras/paper/a/seed_0": "tras_paper_a",
    }
    with pytest.raises(FileNotFoundError, match="finished"):
        to_save(tmp_path, None, 0, ["c"])


def tree(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.mark.parametrize("case", ["a copy", "within", "a file", "a link"])
def test_nothing_is_replaced_and_no_run_grows(run, tmp_path, case):
    target = keep_run(run, tmp_path / "first") and tmp_path / "mine"
    if case == "a copy":
        keep_run(run, target)
    elif case == "within":
        target = run / "docs" / "mine"
    elif case == "a file":
        target.write_text("mine")
    else:
        target.symlink_to(tmp_path / "first")
    before = tree(tmp_path)
    with pytest.raises(ValueError, match="copy") as error:
        keep_run(run, target)
    assert tree(tmp_path) == before and "\n" not in str(error.value)


@pytest.mark.parametrize("commit", ["abc1234-dirty", "unknown", "", None])
def test_a_run_that_nobody_can_make_again_is_saved_on_demand_only(run, tmp_path, commit):
    (run / "origin.json").unlink()
    if commit is not None:
        (run / "origin.json").write_text(json.dumps({"command": "x", "commit": commit}))
    with pytest.raises(ValueError, match="any_commit=true"):
        keep_run(run, tmp_path / "kept")
    assert not (tmp_path / "kept").exists()
    assert keep_run(run, tmp_path / "kept", any_commit=True)


@pytest.mark.parametrize("name", ["metrics.json", "evaluation/sine.csv", "data/secret.csv"])
def test_a_run_with_links_is_not_copied(run, tmp_path, name):
    secret = tmp_path / "secret.csv"
    secret.write_text("time,y\n0,1\n")
    (run / name).unlink(missing_ok=True)
    (run / name).symlink_to(secret)
    with pytest.raises(ValueError, match="anywhere"):
        keep_run(run, tmp_path / "kept")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("metrics.json", b"{"),
        ("evaluation/step.json", b"[]"),
        ("origin.json", b'{"command": 1, "commit": 2}'),
        ("origin.json", b"{}"),
        ("progress.csv", b""),
        ("progress.csv", b"a,b\n1\n"),
        ("data/excitation.csv", b"time,y\n0,1\n0,2\n"),
        ("data/excitation.csv", b'time,y\n0,"1'),
        ("data/step_response.csv", b"\xff\xfe"),
        ("evaluation/sine.csv", b"time,y\n0,<script>\n"),
        ("config.yaml", b"\xff"),
    ],
)
def test_a_damaged_run_is_named_by_its_file(run, tmp_path, name, content):
    (run / name).write_bytes(content)
    with pytest.raises(ValueError, match=f"{name.rpartition('/')[2]} is damaged") as error:
        keep_run(run, tmp_path / "kept")
    assert "\n" not in str(error.value) and not (tmp_path / "kept").exists()


def test_the_saved_runs_of_the_repository_name_no_machine():
    files = list((Path(__file__).parents[2] / "docs" / "results" / "runs").rglob("*"))
    texts = {file: file.read_text() for file in files if file.is_file()}
    assert not [
        str(file) for file, text in texts.items() if any(word in text for word in ("/tmp", "/root", "/home", "/work"))
    ]
    assert not [str(file) for file in files if file.suffix in (".pt", ".png")]
