"""The ablation as a user runs it: interrupted, it goes on where it was."""

import re

import forked


def start(*overrides, cwd):
    return forked.call("ablation", *overrides, cwd=cwd, timeout=600)


def test_only_jobs_of_the_present_command_are_counted(tmp_path):
    earlier = tmp_path / "runs" / "ablation" / "xi" / "smoke" / "direct"
    for name in ("other", "agent.critics-0"):
        (earlier / name / "seed_1").mkdir(parents=True)
        (earlier / name / "seed_1" / "error.txt").write_text("error: earlier\n")
    words = ("experiment=smoke", "system=xi", "setting=direct", "seed=1", "results=results", "agent.critics=1,0")
    done = start(*words, "hydra/launcher=basic", cwd=tmp_path)
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 2 and last.startswith("error: 2 ")
    assert re.findall(r"direct/(\S+?)/seed_1", last) == ["agent.critics-0", "agent.critics-1"]
    assert (earlier / "other" / "seed_1" / "error.txt").read_text() == "error: earlier\n"
