"""What `identify.py` makes of the log of a rig, as its documents say, without a hand's turn: a stand-in of `tras`.

Each log is 120 s long, sampled every 0.01 s in closed loop; the model is fitted to its first half and judged on the
second. See `benchmarks.bench_rig` for what the rig has and its manual does not mention.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import torch

from benchmarks.arguments import LOGS
from benchmarks.bench_rig import closed_loop, write_log
from benchmarks.commit import commit
from dynasindy.safe_io import Row, write_rows

COMMAND = Path(__file__).resolve().parents[2] / "scripts" / "identify.py"
RESULTS, SECONDS = Path("docs/results/standin.csv"), 120.0
CASES = {"still": 0.0, "gusts": 0.01}
"""Standard deviation of accelerations that nothing explains [rad/s^2]."""
TARGETS = {"alpha_a": 0.017, "alpha_p": 0.011, "omega_a": 45.0, "omega_p": 25.0}
"""Errors over 2 s that were reached by hand on the log of a real rig, with some room [rad, rpm]."""
METHODS = {"ours": "rmse_2_s", "linear model on past samples": "linear_rmse_2_s", "last value held": "held_rmse_2_s"}
COLUMNS = ["case", "log", "method", *TARGETS, "delay_ms", "friction", "spring", "commit"]


def main(arguments: argparse.Namespace) -> None:
    """Fly, identify, print a table and write it as CSV."""
    out = RESULTS if arguments.out is None and arguments.logs >= LOGS else arguments.out
    torch.set_num_threads(1)
    rows: list[Row] = []
    for case, gust in CASES.items():
        measured, commands = closed_loop(SECONDS, arguments.logs, gust)
        for log in range(arguments.logs):
            with tempfile.TemporaryDirectory() as folder:
                write_log(Path(folder) / "log.csv", measured[:, log], commands[:, log])
                for row in identified(Path(folder)):
                    rows.append({"case": case, "log": str(log), **row, "commit": commit()})
                    print("  ".join(f"{rows[-1][name]:<10}" for name in COLUMNS[:-1]), flush=True)
            if out is not None:
                write_rows(out, COLUMNS, rows)
    print(f"written to {out}" if out else f"written to no file: fewer than {LOGS} logs; name one by --out")


def identified(folder: Path) -> Iterator[Row]:
    """Run the command as its documents say, and yield what it wrote.

    Raises:
        RuntimeError: The command failed.
    """
    words = ["data=csv", f"data.path={folder / 'log.csv'}", "system=tras", "data.validation_share=0.5"]
    places = [f"folder={folder}", f"hydra.run.dir={folder}"]
    done = subprocess.run([sys.executable, str(COMMAND), *words, *places], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"identify.py ended with {done.returncode}: {done.stderr.strip()}")
    metrics = json.loads((folder / "metrics.json").read_text())
    model = json.loads((folder / "model.json").read_text())
    rates, angle = ("Omega_a", "Omega_p"), "alpha_a"
    terms = {rate: list(model["coefficients"][rate]) for rate in rates}
    found = {
        "delay_ms": f"{1e3 * model.get('delay', 0.0):.2f}",
        "friction": " ".join(rate for rate in rates if any("tanh" in name for name in terms[rate])),
        "spring": " ".join(r for r in rates if any(name.split(" ")[0] == angle for name in terms[r])),
    }
    for method, key in METHODS.items():
        errors = {name: f"{metrics[key][name]:.3g}" for name in TARGETS}
        yield {"method": method, **errors, **(found if method == "ours" else dict.fromkeys(found, ""))}
