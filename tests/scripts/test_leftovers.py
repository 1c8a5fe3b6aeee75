"""What a command leaves behind: nothing beside what was asked for."""

import forked
import pytest


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
