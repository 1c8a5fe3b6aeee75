"""A whole run: build, train, evaluate, write the run folder, say what came of it.

From a checkpoint a run goes on bit for bit as if it had not been stopped. It is one file: a line that names its length
and digest, then the state as torch saves it. TorchRL's `Checkpoint` writes several files without a digest and without
waiting for the disk, so a power cut can leave one that looks complete and is not.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dynasindy.dyna import Stopped
from dynasindy.dyna.callback import Place
from dynasindy.dyna.experiment import Recipe
from dynasindy.dyna.loop import train
from dynasindy.dyna.recorder import IDENTIFICATION, Evaluating, Recorder
from dynasindy.evaluation.metrics import to_text
from dynasindy.findings import Finding, note
from dynasindy.limits import memory_wanted, raise_if_memory
from dynasindy.progress import Progress
from dynasindy.safe_io import locked, read_json, refuse_links, remove_leftovers, replace_file, write_json, write_text
from dynasindy.sentences import check_summary
from dynasindy.systems import Diverged
from dynasindy.text import format_duration


def run(
    recipe: Recipe,
    evaluating: Evaluating,
    folder: Path,
    config: str,
    origin: Mapping[str, str],
    checkpoint_every: int = 1,
    again: str = "dynasindy train",
    finish: bool = False,
) -> dict[str, Any]:
    """Run an experiment and write its folder; go on where an earlier run of the same settings stopped.

    Args:
        recipe: What to run; it is built, and so checked, before the folder is touched.
        evaluating: When and where to evaluate.
        folder: Run folder.
        config: The resolved configuration, as YAML.
        origin: The command, and the commit of the code.
        checkpoint_every: Episodes between two checkpoints; 0 keeps none.
        again: How the command is called that goes on with a run.
        finish: End the run with what it has learnt so far.

    Returns:
        What `metrics.json` holds.

    Raises:
        ValueError: A part refuses its settings, or the folder holds something else or a link, or is in use.
        Stopped: The run was asked to stop.
        Diverged: Its numbers went wrong; what was kept is sound.
        OSError: The folder cannot be written.
    """
    parts, place, checkpoints = recipe.build(), Place(), Checkpoints(folder / "checkpoints")
    recorder = Recorder(folder, parts, evaluating, recipe.train.episodes)
    kept: dict[str, Any] = {"place": place, "parts": parts, "recorder": recorder}

    def _save() -> None:
        if checkpoint_every and place.episodes % checkpoint_every == 0:  # before the first episode, too
            checkpoints.save(place.number, {name: part.state_dict() for name, part in kept.items()})

    recorder.place, recorder.save = place, _save
    with locked(folder):
        refuse_links(folder)
        _check_settings(folder, config)
        if (metrics := result(folder, recipe.train.episodes)) is not None:
            (folder / "error.txt").unlink(missing_ok=True)
            checkpoints.remove()  # of a process that was killed before it did
            return metrics
        with _left_in_order(recorder, place, checkpoints, again):
            state = checkpoints.newest()
            if state is None and finish:
                raise ValueError(f"{folder} keeps no checkpoint, there is nothing to finish; leave out finish=true")
            if state is None:
                checkpoints.remove()  # damaged ones, whose numbers would rank before the new
                for name in MADE:  # of an earlier run of the same settings: no result outlives its run
                    (folder / name).unlink(missing_ok=True)
                for each in (folder, folder / "data"):
                    remove_leftovers(each)
                write_text(folder / "config.yaml", config)
                write_json(folder / "origin.json", dict(origin))
                recorder.begin()
            else:
                try:
                    for name, part in kept.items():
                        part.load_state_dict(state[name])
                except (AttributeError, AssertionError, LookupError, RuntimeError, TypeError, ValueError) as error:
                    raise_if_memory(error)
                    why = str(error).splitlines()[0]
                    raise ValueError(
                        f"{checkpoints.folder} does not fit the config.yaml beside it ({why}); restore the pair, or "
                        "remove it to begin anew"
                    ) from error
                for name in ("error.txt", "metrics.json"):  # of a run that was ended early, which now goes on
                    (folder / name).unlink(missing_ok=True)
                file, commit = folder / "origin.json", origin.get("commit")
                begun = read_json(file) if file.is_file() else {}
                if commit != begun.get("commit"):  # other code goes on than began it
                    write_json(file, {**begun, "resumed_at_commit": commit})
            with Progress():
                if not finish:
                    recorder.progress(place.episodes)
                    train(parts, recipe.train, recorder, place)
                metrics = recorder.finish({"seed": recipe.seed, "system": type(recipe.system).__name__.lower()})
        (folder / "error.txt").unlink(missing_ok=True)  # of a process that was refused meanwhile
        if place.episodes == recipe.train.episodes:
            checkpoints.remove()
    return metrics


FREE = ("folder:", "threads:", "device:", "results:", "resume:", "finish:", "plugins:")
"""Keys of a configuration, as its lines begin, that do not change a result."""


def _check_settings(folder: Path, settings: str) -> None:
    """Make sure that a run folder is empty or holds a run of the same settings; null may be one that older runs had."""
    config = folder / "config.yaml"
    if not config.is_file():
        others = [file.name for file in folder.iterdir() if not file.name.startswith(".") and file.name not in MADE]
        if others:
            raise ValueError(f"{folder} holds other files, such as {min(others)}; give a new folder")
        return
    ours, theirs = (
        [line for line in text.splitlines() if not line.startswith(FREE) and not line.endswith(": null")]
        for text in (settings, config.read_text())
    )
    if ours != theirs:
        differ = next((a or b for a, b in zip([*ours, ""], [*theirs, ""]) if a != b), "its length")
        raise ValueError(
            f"{folder} holds a run of other settings, such as '{differ.strip()}'; give another folder, or remove it"
        )


@contextmanager
def _left_in_order(recorder: Recorder, place: Place, checkpoints: Checkpoints, again: str) -> Iterator[None]:
    """Say what was kept of a run that is asked to stop, whose numbers go wrong, or that runs out of memory."""

    def kept() -> str:
        folder, done = checkpoints.folder.parent, Place()
        if (state := checkpoints.newest()) is None:
            return f"nothing is kept in {folder} yet, the same command begins anew"
        done.load_state_dict(state["place"])
        near = folder.absolute()
        near = near.relative_to(Path.cwd()) if near.is_relative_to(Path.cwd()) else folder
        return (
            f"the run is kept up to the end of {done.summary()}: go on with {again} resume={near} "
            "(with finish=true, to evaluate and draw what it has learnt instead)"
        )

    try:
        yield
    except KeyboardInterrupt as stop:
        recorder.write_tables()
        raise Stopped(f"stopped; {kept()}", getattr(stop, "signal", 2)) from stop
    except Diverged as error:
        recorder.write_tables()
        raise Diverged(f"in {place.present(recorder.episodes)}: {error}; {kept()}") from error
    except Exception as error:
        if (wanted := memory_wanted(error)) is None:
            raise
        where = f"in {place.present(recorder.episodes)}{wanted and f', where {wanted} more were wanted'}"
        raise MemoryError(f"{where}; {kept()}") from error


NIS = (
    "Observer: its normalised innovation squared is {:.2g}. It is 1 where measurements stray from what it expects as "
    "far as its noise levels say, larger where they stray further."
)


def run_report(metrics: dict[str, Any], folder: Path) -> str:
    """Return what a user reads at the end: equations, step tracking, cost, folder."""
    cost = metrics["cost"]
    lines = ["", "Identified equations", *(f"  {equation}" for equation in metrics["equations"]), ""]
    if metrics.get("delay"):
        lines[-1:] = [f"  {note('model.delay', seconds=metrics['delay'])}", ""]
    if (file := folder / IDENTIFICATION).is_file():
        lines[-1:] = [f"What the excitation alone could tell, the first fit: {file}", ""]
    findings = [Finding.from_record(record) for record in metrics.get("findings", ())]
    checked = [Finding.from_record(record) for record in (metrics.get("check") or {}).get("findings", ())]
    untrained = metrics["untrained"]["return"]
    title = f"Policy on the plant, scenario '{metrics['scenario']}' (untrained return {untrained:.1f})"
    steady, nis = metrics.get("steady_seconds", 5.0), (metrics.get("observer") or {}).get("nis")
    planned = metrics.get("planning")
    of_plant = planned.get("why") if isinstance(planned, dict) else ""  # earlier versions had a sentence there
    lines.append(to_text(metrics["evaluation"], title, metrics.get("state_units") or metrics.get("units"), steady))
    lines += [
        "",
        f"Cost: the plant moved for {format_duration(cost['plant_seconds'])} to learn, which are {cost['real_steps']} "
        f"control periods. The model imagined {cost['imagined_transitions']} periods, and the policy was updated "
        f"{cost['updates']} times, all in {format_duration(round(cost['wall_seconds']))}. The evaluations moved the "
        f"plant for {cost['evaluation_steps']} periods more, from which nothing was learnt.",
        *(each.line() for each in findings if not each.code.startswith("run.")),
        *([f"Reward: {metrics['reward']}"] if metrics.get("reward") else []),
        *([f"The model says of the plant: {of_plant}."] if of_plant else []),
        *([] if nis is None else [NIS.format(nis)]),
        *(f"{str(each)[:1].upper()}{str(each)[1:]}." for each in findings if each.code.startswith("run.")),
        *([f"Check on the model, {folder / 'check'}: {check_summary(checked)}"] if checked else []),
        f"Run folder: {folder}",
    ]
    return "\n".join(lines)


MADE = (
    *("metrics.json", "policy.pt", "model.json", "observer.json", "controller.json"),
    *("progress.csv", "gate.csv", "identification.txt", "error.txt"),
)
"""Files that a run makes besides its `config.yaml`."""
NEEDED = {"episodes", "cost", "evaluation", "untrained", "equations", "verdict"}
"""Keys of `metrics.json` that are read again."""
MARK = b"dynasindy checkpoint 1"
KEPT = 2
"""How many checkpoints stay: the newest, and one before it in case it is damaged."""
State = dict[str, Any]


def result(folder: Path, episodes: int) -> dict[str, Any] | None:
    """Return what `metrics.json` holds if the run has ended and its files are sound, else None.

    Args:
        folder: Run folder.
        episodes: Real episodes that the settings ask for; a run that was ended earlier has not ended.
    """
    try:
        metrics = json.loads((folder / "metrics.json").read_text())
        json.loads((folder / "model.json").read_text())
        complete = metrics.keys() >= NEEDED and metrics["episodes"] == episodes
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise_if_memory(error)  # else a run that has ended would begin anew
        return None
    return metrics if complete and _read(folder / "policy.pt") is not None else None


def read_weights(file: Path, wanted: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the saved weights if they have the names and shapes of those wanted.

    Args:
        file: The `policy.pt` of a run.
        wanted: State of the policy that the run's configuration builds.

    Raises:
        ValueError: The file is damaged, or holds the weights of another network, or weights that are not finite.
    """
    saved, shapes = _read(file), {name: weight.shape for name, weight in wanted.items()}
    if saved is None or {name: weight.shape for name, weight in saved.items()} != shapes:
        raise ValueError(f"{file} does not hold the weights of the agent in its config.yaml; restore the pair")
    if not all(bool(weight.isfinite().all()) for weight in saved.values()):
        raise ValueError(f"{file} holds weights that are not finite; train again")
    return saved


def _read(file: Path) -> dict[str, Tensor] | None:
    """Return the tensors of a file; None of another file."""
    try:
        saved = _load_tensors(file.read_bytes())
    except OSError as error:
        raise_if_memory(error)
        return None
    plain = (
        isinstance(name, str) and isinstance(w, Tensor) and w.layout == torch.strided and w.device.type == "cpu"
        for name, w in (saved or {}).items()
    )
    return saved if all(plain) else None


def _load_tensors(payload: bytes) -> dict[Any, Any] | None:
    """Return the mapping that torch has saved, with plain data alone and nothing that swells; None of anything else."""
    try:
        with zipfile.ZipFile(io.BytesIO(payload)) as archive:
            swells = any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist())
        saved = None if swells else torch.load(io.BytesIO(payload), weights_only=True, map_location="cpu")
    except Exception as error:  # any: what a file of others makes the reader do ends here
        raise_if_memory(error)  # for which nothing is begun anew
        return None
    return saved if isinstance(saved, dict) else None


class Checkpoints:
    """The newest states of a run, in a folder.

    Args:
        folder: Folder of the files; made when the first is written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def save(self, number: int, state: Mapping[str, Any]) -> Path:
        """Write a state as `NUMBER.pt`, whole or not at all, and then remove all but the newest.

        Args:
            number: Its place in the order of states.
            state: Tensors, numbers, text, and lists and dictionaries of them.

        Raises:
            OSError: The file cannot be written; the earlier ones stay.
        """
        buffer = io.BytesIO()
        torch.save(dict(state), buffer)
        path = self.folder / f"{number:06d}.pt"
        with replace_file(path) as file:
            file.write(_head(buffer.getbuffer()))
            file.write(buffer.getbuffer())
        for old in self._files()[:-KEPT]:
            old.unlink(missing_ok=True)
        return path

    def newest(self) -> State | None:
        """Return the newest state whose file is sound, or None."""
        for path in reversed(self._files()):
            with path.open("rb") as file:  # for an error of the disk nothing is begun anew
                head, payload = file.readline(200), file.read()
            if head == _head(payload) and (state := _load_tensors(payload)) is not None:
                return state
        return None

    def remove(self) -> None:
        """Remove all checkpoints, as of a run that has ended."""
        remove_leftovers(self.folder)
        for path in self._files():
            path.unlink(missing_ok=True)
        if self.folder.is_dir() and not any(self.folder.iterdir()):
            self.folder.rmdir()

    def _files(self) -> list[Path]:
        return sorted(self.folder.glob("[0-9]*.pt"))


def _head(payload: bytes | memoryview) -> bytes:
    return b"%s %d %s\n" % (MARK, len(payload), hashlib.blake2b(payload, digest_size=20).hexdigest().encode())
