"""What a report is made of: saved runs and tables of results, each with the command that makes it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dynasindy.evaluation.given import read_record, read_text, understood
from dynasindy.evaluation.rows import read_rows
from dynasindy.viz.controllers import named
from dynasindy.viz.report.document import Finding, Part, Statement, Text
from dynasindy.viz.run import Table, read_table

REPORT = "python scripts/report.py"
PLANTS = ("xi", "tras")
CASES = tuple((plant, experiment) for plant in PLANTS for experiment in ("dyna", "paper"))
"""What the ablation compares its settings in."""
SETTINGS = {setting: named(setting) for setting in ("rollouts_0", "rollouts_400", "rollouts_800")}
MODEL_FREE = {
    setting: named(setting) for setting in ("rollouts_0_tuned", "sb3_sac", "sb3_sac_5", "sb3_td3", "sb3_td3_5")
}
"""Other settings of the ablation that have no model, which planning is compared with too."""


class MissingResult(FileNotFoundError):
    """A result that a section needs is not there; the message says which command makes it."""


@dataclass(frozen=True)
class Run:
    """A saved run.

    Attributes:
        folder: Where it lies.
        settings: Its resolved configuration.
        make: Command that makes what it lacks.
    """

    folder: Path
    settings: Mapping[str, Any]
    make: str

    def table(self, name: str) -> Table:
        """Read one of its CSV files.

        Raises:
            MissingResult: The run does not have it.
        """
        return read_table(self._file(name))

    def record(self, name: str) -> dict[str, Any]:
        """Read one of its JSON files.

        Raises:
            MissingResult: The run does not have it.
        """
        return read_record(self._file(name))

    def setting(self, key: str) -> Any:
        """Return a setting by its dotted key, None where the run has none."""
        value: Any = self.settings
        for step in key.split("."):
            value = value.get(step) if isinstance(value, Mapping) else None
        return value

    @property
    def source(self) -> str:
        """Folder, command and commit in words."""
        origin = self.record("origin.json")
        return f"Run `{_shown(self.folder)}`, made by `{origin['command']}` at commit {origin['commit']}."

    def _file(self, name: str) -> Path:
        file = self.folder / name
        if not file.is_file():
            raise MissingResult(f"Not measured: `{_shown(self.folder)}` has no `{name}`; {self.make} makes it.")
        return file


@dataclass(frozen=True)
class Results:
    """The folder of results.

    Attributes:
        folder: Tables as CSV files, and `runs/` with saved runs.
        settings: Resolved configuration of each saved run, by name.
        asked: Names of the runs that were asked for until now, saved or not.
    """

    folder: Path
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    asked: set[str] = field(default_factory=set, compare=False)

    def compared(self, system: str, experiment: str, setting: str) -> Run:
        """Return the saved run of an ablation's setting.

        Raises:
            MissingResult: It is not saved.
        """
        train = f"python scripts/ablation.py system={system} experiment={experiment} setting={setting} seed=0"
        return self.run(f"{system}_{experiment}_{setting}", f"`{train}`, then `{REPORT} save=runs/ablation`")

    def trained(self, system: str) -> Run:
        """Return the saved run of the main job on a plant.

        Raises:
            MissingResult: It is not saved.
        """
        folder = f"runs/{system}_gradient"
        train = f"python scripts/train.py system={system} folder={folder}"
        return self.run(f"{system}_gradient", f"`{train}`, then `{REPORT} save={folder}`")

    def run(self, name: str, make: str) -> Run:
        """Return a saved run by name.

        Raises:
            MissingResult: It is not saved; `make` is what makes it.
        """
        folder = self.folder / "runs" / name
        self.asked.add(name)
        if name not in self.settings or not folder.is_dir():
            raise MissingResult(f"Not measured: no saved run `{name}`; {make} makes it.")
        return Run(folder, self.settings[name], make)

    def rows(self, name: str, make: str) -> list[dict[str, str]]:
        """Read a table of words and numbers, cell by cell as it stands.

        Raises:
            MissingResult: It is not there; `make` is the command that makes it.
        """
        file = self.folder / name
        if not file.is_file():
            raise MissingResult(f"Not measured: no `{_shown(file)}`; `{make}` makes it.")
        return read_rows(file)

    def source(self, name: str) -> str:
        """Return where a table lies, the command that the README of the results lists for it, and its commits.

        They are those that its rows name; where a table has no such column, what the README lists.
        """
        listed = self.folder / "README.md"
        pattern = rf"^\| [^|\n]*(?<![\w/]){re.escape(name)}\b[^|\n]*\| `([^`]+)`[^|\n]*\|([^|\n]*)\|"
        found = re.search(pattern, read_text(listed), re.M) if listed.is_file() else None
        named = commits(self.rows(name, "")) if (self.folder / name).is_file() else ""
        commit = f" at commit {named or found[2].strip()}" if found and (named or found[2].strip()) else ""
        made = f", made by `{found[1]}`{commit}" if found else ""
        return f"Table `{_shown(self.folder / name)}`{made}."

    def of_runs(self, name: str, rows: Sequence[Mapping[str, str]]) -> str:
        """Return where rows over seeds lie, the commits of their runs, their commands, and which of them are saved.

        Args:
            name: Name of the table that is drawn.
            rows: A row per run of `ablation.csv`.
        """
        found = commits(rows)
        of = f" at commit {found}" if found else ""
        saved = [run.source for row in rows if (run := self._same(row))]
        first = f" First seeds: {' '.join(saved)}" if saved else ""
        made = listed(_commands(rows))
        return f"Table `{_shown(self.folder / name)}`, of runs with the settings of {made}{of}.{first}"

    def lengths(self, system: str, experiment: str) -> set[int]:
        """Return after how many real episodes the runs behind the curves of the paper's settings ended."""
        file = self.folder / "ablation.csv"
        case = (system, experiment)
        rows = read_rows(file) if file.is_file() else []
        return {
            _length(row) for row in rows if (row["system"], row["experiment"]) == case and row["setting"] in SETTINGS
        }

    def _same(self, row: Mapping[str, str]) -> Run | None:
        """Return the saved run that a row is of: the same seed, number of episodes and commit."""
        name = "_".join((row["system"], row["experiment"], row["setting"]))
        if name not in self.settings:
            return None
        run = self.compared(row["system"], row["experiment"], row["setting"])
        there = (
            str(run.setting("seed") or 0),
            int(run.setting("train.episodes") or 0),
            run.record("origin.json")["commit"],
        )
        return run if there == (row["seed"], _length(row), row.get("commit")) else None


def listed(words: Iterable[str]) -> str:
    """Return words with commas and an "and"."""
    *most, last = list(words) or [""]
    return f"{', '.join(most)} and {last}" if most else last


def _length(row: Mapping[str, str]) -> int:
    return int(float(row["episodes"]))


def _commands(rows: Iterable[Mapping[str, str]]) -> list[str]:
    """Return the commands that make the runs of rows, those of one plant, experiment and length by one."""
    found: dict[tuple[str, str, int], list[Mapping[str, str]]] = {}
    for row in rows:
        found.setdefault((row["system"], row["experiment"], _length(row)), []).append(row)
    return [
        f"`python scripts/ablation.py system={system} experiment={experiment} train.episodes={length} "
        f"setting={_values(group, 'setting')} seed={_values(group, 'seed')}`"
        for (system, experiment, length), group in found.items()
    ]


def _values(rows: Iterable[Mapping[str, str]], name: str) -> str:
    return ",".join(dict.fromkeys(row[name] for row in rows))


def told(plant: str, experiment: str) -> str:
    """Return a case in words."""
    return f"{plant}, `{experiment}`"


def commits(rows: Iterable[Mapping[str, str]]) -> str:
    """Return the commits that rows name, in words; empty where they name none."""
    return listed(dict.fromkeys(row.get("commit") or "" for row in rows))


def each(build: Callable[..., list[Part]], *cases: tuple[str, ...], statements: Sequence[Statement] = ()) -> list[Part]:
    """Return the parts of every case, findings first.

    Args:
        build: Makes the parts of a case; where a result, or a column of it, is missing, a line stands for them that
            says what makes it.
        cases: Arguments of `build`; a plant and an experiment where there are statements.
        statements: What `build` judges; not measured where it cannot.

    Raises:
        DamagedFileError: What is saved is not what the section expects.
    """
    parts: list[Part] = []
    for case in cases:
        with understood(f"what is saved of {' '.join(case) or build.__module__.rpartition('.')[2]}"):
            try:
                parts += build(*case)
            except MissingResult as missing:
                parts += [Text(str(missing)), *(one.unmeasured(told(*case)) for one in statements)]
            except KeyError as column:
                words = f"saved results of {' '.join(case)} have no {column}; they are older than this report"
                again = f"Run their commands again, then `{REPORT} save=runs/ablation`."
                parts.append(Text(f"Not measured: {words}. {again}"))
                parts += [one.unmeasured(told(*case)) for one in statements]
    return sorted(parts, key=lambda part: not isinstance(part, Finding))


def _shown(path: Path) -> str:
    """Return a path as a reader of the repository knows it."""
    parts = path.parts
    return "/".join(parts[parts.index("docs") :] if "docs" in parts else parts[-2:])
