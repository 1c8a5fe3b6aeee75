"""What a report is made of: saved runs and tables of results, each with the command that makes it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dynasindy.safe_io import read_json, read_rows, reading
from dynasindy.viz.controllers import controller_name
from dynasindy.viz.report.document import Finding, Part, Statement, Text
from dynasindy.viz.run import Table, read_table

REPORT = "python scripts/report.py"
PLANTS = ("xi", "tras")
CASES = tuple((plant, experiment) for plant in PLANTS for experiment in ("dyna", "paper"))
"""What the ablation compares its settings in."""
SETTINGS = {setting: controller_name(setting) for setting in ("rollouts_0", "rollouts_400", "rollouts_800")}
NONE, SOME, MANY = SETTINGS.values()
ABLATION = "python scripts/ablation.py system={} experiment={}"
Row = Mapping[str, str]


class MissingResult(FileNotFoundError):
    """A result that a section needs is not there; the message says which command makes it."""


@dataclass(frozen=True)
class Run:
    """A saved run: its folder, its resolved configuration, and the command that makes what it lacks."""

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
        return read_json(self._file(name))

    def setting(self, key: str) -> Any:
        """Return a setting by its dotted key, None where the run has none."""
        value: Any = self.settings
        for step in key.split("."):
            value = value.get(step) if isinstance(value, Mapping) else None
        return value

    @property
    def episodes(self) -> int:
        """Real episodes after which it ended."""
        return int(self.setting("train.episodes") or 0)

    @property
    def source(self) -> str:
        """Folder, command and commit in words."""
        origin = self.record("origin.json")
        return f"Run `{_path(self.folder)}`, made by `{origin['command']}` at commit {origin['commit']}."

    def _file(self, name: str) -> Path:
        file = self.folder / name
        if not file.is_file():
            raise MissingResult(f"Not measured: `{_path(self.folder)}` has no `{name}`; {self.make} makes it.")
        return file


@dataclass(frozen=True)
class Results:
    """The folder of results.

    Attributes:
        folder: Tables as CSV files, and `runs/` with saved runs.
        settings: Resolved configuration of each saved run, by name.
        requested: Names of the runs that sections asked for, saved or not.
    """

    folder: Path
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    requested: set[str] = field(default_factory=set, compare=False)

    def ablation_run(self, system: str, experiment: str, setting: str) -> Run:
        """Return the saved run of an ablation's setting.

        Raises:
            MissingResult: It is not saved.
        """
        train = f"{ABLATION.format(system, experiment)} setting={setting} seed=0"
        return self.run(f"{system}_{experiment}_{setting}", f"`{train}`, then `{REPORT} save=runs/ablation`")

    def main_run(self, system: str) -> Run:
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
        self.requested.add(name)
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
            raise MissingResult(f"Not measured: no `{_path(file)}`; `{make}` makes it.")
        return read_rows(file)

    def source(self, name: str, make: str, rows: Iterable[Row] = ()) -> str:
        """Return where a table lies, the command that makes it and the commits that rows of it name."""
        commits = listed(dict.fromkeys(row.get("commit") or "" for row in rows))
        return f"Table `{_path(self.folder / name)}`, made by `{make}`{f' at commit {commits}' if commits else ''}."

    def lengths(self, system: str, experiment: str) -> list[int]:
        """Return after how many real episodes the runs behind the curves of the paper's settings ended."""
        file = self.folder / "ablation.csv"
        rows = read_rows(file) if file.is_file() else []
        own = [row for row in rows if (row["system"], row["experiment"]) == (system, experiment)]
        return sorted({int(float(row["episodes"])) for row in own if row["setting"] in SETTINGS})


def listed(words: Iterable[object]) -> str:
    """Return words with commas and an "and"."""
    *most, last = [str(word) for word in words] or [""]
    return f"{', '.join(most)} and {last}" if most else last


def case_name(plant: str, experiment: str) -> str:
    """Return a case in words."""
    return f"{plant}, `{experiment}`"


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
        with reading(f"what is saved of {' '.join(case) or build.__name__.strip('_')}"):
            try:
                parts += build(*case)
                continue
            except MissingResult as missing:
                words = str(missing)
            except KeyError as column:
                words = (
                    f"Not measured: saved results of {' '.join(case)} have no {column}; they are older than this "
                    f"report. Run their commands again, then `{REPORT} save=runs/ablation`."
                )
        parts += [Text(words), *(Finding(statement, case_name(*case)) for statement in statements)]
    return sorted(parts, key=lambda part: not isinstance(part, Finding))


def _path(path: Path) -> str:
    """Return a path as a reader of the repository knows it."""
    parts = path.parts
    return "/".join(parts[parts.index("docs") :] if "docs" in parts else parts[-2:])
