"""What a report is made of: saved runs and tables of results, each with the command that makes it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dynasindy.safe_io import read_json, read_rows, reading
from dynasindy.viz.controllers import controller_name
from dynasindy.viz.report.document import Finding, Part, Section, Statement
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
        """Read one of its CSV files, or raise `MissingResult`."""
        return read_table(self._file(name))

    def record(self, name: str) -> dict[str, Any]:
        """Read one of its JSON files, or raise `MissingResult`."""
        return read_json(self._file(name))

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
    """

    folder: Path
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def run(self, system: str, experiment: str, setting: str = "rollouts_800") -> Run:
        """Return the saved run of an ablation's setting; where the experiment is `gradient`, that of the main job.

        Raises:
            MissingResult: It is not saved.
        """
        if experiment == "gradient":
            name = f"{system}_gradient"
            make, made = f"python scripts/train.py system={system} folder=runs/{name}", f"runs/{name}"
        else:
            name = f"{system}_{experiment}_{setting}"
            make = f"{ABLATION.format(system, experiment)} setting={setting} seed=0"
            made = f"runs/ablation/{system}/{experiment}/{setting}/seed_0"
        words = f"`{make}`, then `cp -r {made} {_path(self.folder)}/runs/{name}`,"
        if name not in self.settings or not (self.folder / "runs" / name).is_dir():
            raise MissingResult(f"Not measured: no saved run `{name}`; {words} makes it.")
        return Run(self.folder / "runs" / name, self.settings[name], words)

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

    def episodes(self, system: str, experiment: str, settings: Iterable[str] = ("rollouts_800",)) -> str:
        """Return after how many real episodes saved runs of settings ended, and where they differ those of figure 11.

        Raises:
            MissingResult: One is not saved.
        """
        runs = [self.run(system, experiment, name) for name in settings]
        saved = sorted({int(run.setting("train.episodes") or 0) for run in runs})
        file = self.folder / "ablation.csv"
        rows = read_rows(file) if file.is_file() else []
        own = [row for row in rows if (row["system"], row["experiment"]) == (system, experiment)]
        curves = sorted({int(float(row["episodes"])) for row in own if row["setting"] in SETTINGS})
        return f"{listed(saved)} episodes" + (f", {listed(curves)} in figure 11" if set(curves) - set(saved) else "")


Case = tuple[str, ...]
Builder = Callable[..., Iterable[Part | Finding]]


@dataclass(frozen=True)
class Entry:
    """A section as the list of sections has it.

    Attributes:
        title: Its heading.
        words: What the paper shows and how it is shown here.
        builders: What makes its parts of the results, and the cases it does so for: the further arguments.
        statements: What the first builder judges by plant and experiment, each in its place.
    """

    title: str
    words: str
    builders: Sequence[tuple[Builder, Sequence[Case]]] = ()
    statements: Sequence[Statement] = ()

    def section(self, results: Results) -> Section:
        """Build the section; where a result or a column of it is missing, a line says what makes it.

        Raises:
            DamagedFileError: What is saved is not what the section expects.
        """
        section = Section(self.title, self.words)
        for build, cases in self.builders:
            for case in cases:
                words = " ".join(case) or self.title
                with reading(f"what is saved of {words}"):
                    try:
                        made = list(build(results, *case))
                    except MissingResult as missing:
                        made = [str(missing)]
                    except KeyError as column:
                        again = f"run their commands again, and put their folders into `{_path(results.folder)}/runs`"
                        made = [f"Not measured: saved results of {words} are older and have no {column}; {again}."]
                section.parts += [part for part in made if not isinstance(part, Finding)]
                if build is self.builders[0][0]:
                    judged = [part for part in made if isinstance(part, Finding)] or [Finding()] * len(self.statements)
                    pairs = zip(self.statements, judged, strict=True)
                    section.findings += [one._replace(statement=what, case=case_name(*case)) for what, one in pairs]
        return section


def listed(words: Iterable[object]) -> str:
    """Return words with commas and an "and"."""
    *most, last = [str(word) for word in words] or [""]
    return f"{', '.join(most)} and {last}" if most else last


def case_name(plant: str, experiment: str, *_: str) -> str:
    """Return a case in words."""
    return f"{plant}, `{experiment}`"


def _path(path: Path) -> str:
    """Return a path as a reader of the repository knows it, which may itself lie below a folder `docs`."""
    parts = path.parts
    return "/".join(
        parts[max(k for k, part in enumerate(parts) if part == "docs") :] if "docs" in parts else parts[-2:]
    )
