"""Findings in words: the one place in which they are written.

Settings are named as the reader knows them: as arguments of functions, or on the command line by their keys.
"""

from __future__ import annotations

import math
import re
import string
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dynasindy.text import format_duration, unit_suffix

if TYPE_CHECKING:
    from dynasindy.findings import Finding

_words_of_commands = False
CALLS = {"data.states": "read", "data.inputs": "read", "plant.known": "identify"}
"""Functions that take a mapping that is one word on the command line."""
SETTING = re.compile(r"<([a-z_]+(?:\.[a-z_]+)+)((?:=[^>]*)?)>")
PLAIN = re.compile(r"[^\W\d][\w ./^²°%-]*|[-+]?[\d.]+(?:e[-+]?\d+)?|NUMBER")
"""A word that YAML takes without quotation marks."""
FEW = 4
"""Names that a sentence lists."""
WORDS = {True: "CONTROLLED", False: "NOT CONTROLLED", None: "NOT JUDGED"}
HEADS = {"note": "note", "weak": "warning", "wrong": "wrong"}


def use_command_words() -> None:
    """Name settings by their keys from now on in this process, as the commands do."""
    global _words_of_commands
    _words_of_commands = True


def setting(key: str, value: Any = None) -> str:
    """Return a setting, and its value if there is one, as the reader gives it.

    Args:
        key: Its key, as `data.dt`.
        value: What to give it; a mapping or a list is written out.
    """
    name = key.rpartition(".")[2]
    if value is None:
        return key if _words_of_commands else name
    if _words_of_commands:
        word = command_word(key, value)
        return f"'{word}'" if {*word} & {*'{"'} else word
    return f"{CALLS[key]}({name}={value!r})" if key in CALLS else f"{name}={value!r}"


def command_word(key: str, value: Any) -> str:
    """Return a setting as a word of the command line, not quoted for a shell."""
    return f"{key}={_flow(value)}"


def sentence(code: str, values: Mapping[str, Any]) -> str:
    """Return a finding in words.

    Args:
        code: What was found.
        values: Numbers and names of it.
    """
    template = SENTENCES.get(code)
    rest = {name: value for name, value in values.items() if name != "file"}
    try:
        text = "" if template is None else template(**rest) if callable(template) else _fill(template, rest)
    except (KeyError, TypeError):
        text = ""
    if not text:  # of a file that another version wrote
        return f"{code}: {', '.join(f'{name} {value}' for name, value in values.items())}"
    text = SETTING.sub(_named, text)
    return f"{values['file']}: {text}" if "file" in values else text


def _named(found: re.Match[str]) -> str:
    return setting(found[1]) + found[2]


def gravest_first(findings: Iterable[Finding]) -> list[Finding]:
    """Return findings by their severity: what is wrong, what is weak, notes."""
    return sorted(findings, key=lambda each: -[*HEADS].index(each.severity))


def lines(findings: Iterable[Finding]) -> list[str]:
    """Return a line for each finding, the gravest first."""
    return [each.line() for each in gravest_first(findings)]


class _Formatter(string.Formatter):
    """Format lists, durations, units, settings, words for one or many, and words said if a value is true."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if format_spec in FORMATS:
            return FORMATS[format_spec](value)
        if "|" in format_spec:
            return format_spec.split("|")[value != 1].replace("#", str(value))
        if format_spec.startswith("?"):
            return f" {format_spec[1:]}" if value else ""
        named = "." in format_spec[1:-1] and format_spec[0].isalpha()
        return setting(format_spec, value) if named else format(value, format_spec)


def _fill(template: str, values: Mapping[str, Any]) -> str:
    return _Formatter().vformat(template, (), values)


def _flow(value: Any) -> str:
    """Return a value as YAML writes it in one line."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{name}: {_flow(each)}' for name, each in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{','.join(map(_flow, value))}]"
    text = value if isinstance(value, str) else f"{value:.7g}" if isinstance(value, float) else str(value)
    return text if PLAIN.fullmatch(text) else f'"{text}"'


def error_of(value: float) -> str:
    """Return an error in two digits, `-` of what is no number."""
    if math.isnan(value):
        return "-"
    return f"{value:.2g}" if abs(value) < 100 else (f"{value:.0f}" if math.isfinite(value) else "runs away")


FORMATS: dict[str, Callable[[Any], str]] = {
    "list": lambda values: ", ".join(f"{each:g}" if isinstance(each, float) else str(each) for each in values),
    "and": lambda values: " and ".join(filter(None, [", ".join(map(str, values[:-1])), *map(str, values[-1:])])),
    "shares": lambda shares: ", ".join(f"{100 * share:.3g} % in {name}" for name, share in shares.items()),
    "percent": lambda share: f"{100 * share:.3g} %",
    "time": format_duration,
    "unit": unit_suffix,
    "error": error_of,
}


# --- the log ---------------------------------------------------------------------------------------------------------


LEFT_OUT = {
    "constant": "never changing",
    "counter": "growing evenly, as a counter or a second clock does",
    "words": "words (write UP and DOWN as 1 and 0)",
    "empty": "empty",
    "dates": "dates beside the time",
    "reference": "references by name",
    "label": "labels, of two values or a few that hardly change",
    "derived": "sums of a few multiples or products of other columns, or roots or integrals of such",
    "noise": "noise from row to row, which nothing in the row before tells",
    "unmoved": "moved by no other column, and telling nothing of others",
    "shifted": "samples of other columns a row earlier or later",
    "direct": "jumping with an input, as an acceleration does and no state can",
}
"""Why columns are left out that nobody named."""


def _left_out(why: str, columns: Mapping[str, Any] | Sequence[str]) -> str:
    known = columns if isinstance(columns, Mapping) else dict.fromkeys(columns, "")
    names = [f"{name} ({value:g})" if isinstance(value, float) else name for name, value in known.items()]
    return f"left out, as {LEFT_OUT[why]}: {', '.join(names)}; <data.states> or <data.inputs> may name them"


def _taken(left_out: Sequence[Finding]) -> str:
    return "".join(f" {str(each)[:1].upper()}{str(each)[1:]}." for each in left_out)


def _no_roles(
    path: str,
    columns: Sequence[str],
    numbers: Sequence[str],
    lacks: str,
    clock: str,
    left_out: Sequence[Finding],
    guess: Mapping[str, Any] | None = None,
) -> str:
    lacking = {
        "time": f"none of them is called {clock}",
        "inputs": "none that moves is called u, u_... or input_..., as inputs are",
        "states": "besides time and inputs none is left, which would be a state",
    }
    return (
        f"{path} has the columns {', '.join(columns)}, with numbers in {', '.join(numbers) or 'none'}; "
        f"{lacking[lacks]}. Say which is the time, and which are inputs and states, one at least, by <data.time>, "
        f"<data.inputs> and <data.states>.{_taken(left_out)}{_guess(**guess) if guess else ''}"
    )


def _guess(time: str | None, **roles: Sequence[str]) -> str:
    hint = "" if time else " No column grows as time does: log it, or give <data.dt>, the time between two rows."
    given = roles if time in (None, "time") else {"time": time, **roles}
    words = [f"'data.{key}={_flow(v)}'" if _words_of_commands else f"{key}={v!r}" for key, v in given.items()]
    words += [] if time else [f"{setting('data.dt')}=SECONDS"]
    copied = " ".join(words) if _words_of_commands else f"read(path, {', '.join(words)})"
    return f"{hint} This is a first guess, to be corrected: {copied}"


def _rate_units(state: str, rate: str, factor: float, guessed: bool, unit: str = "", states: Any = None) -> str:
    slope = f"{rate} does not fit {state}, whose slope over time is {factor:.3g} times {rate}"
    if states is not None:
        return f"{slope}, as which it was given; allowed is a rate in {unit}: give {setting('data.states', states)}"
    guess = f" That it is the rate of {state} is a guess; a unit of its own, as 'motor rad/s', says that it is none"
    return f"{slope}: in which units are they? Correct them, or give a scale in <data.states>.{guess * guessed}"


def _quiet(steps: Mapping[str, int], wanted: int, inputs: Mapping[str, float | None]) -> str:
    which = " and ".join(f"{name}, which moves by {count} steps of its sensor" for name, count in steps.items())
    far = (
        f"{n}, which does not move" if by is None else f"{n} {max(by, 1.1):.2g} times as far"
        for n, by in inputs.items()
    )
    return f"the log is too quiet to tell of {which}, where some {wanted} are wanted: move {', or '.join(far)}"


# --- the fit ---------------------------------------------------------------------------------------------------------


SEPARATE = 1e6
"""Condition number below which functions are well apart."""


def _identifiability(rank: int, count: int, condition: float, weakest: Mapping[str, float], read: Sequence[str]) -> str:
    if rank < count:
        which = f"{count - rank} of the {count} candidate functions that each equation may have"
        return f"{which} cannot be told apart from others by these data: let {', '.join(read)} move more, or otherwise"
    known = f"condition number {condition:.2g}"
    if condition < SEPARATE:
        return f"the data can tell all {count} candidate functions apart ({known}; below {SEPARATE:,.0f} is good)"
    return (
        f"these of {count} candidate functions can hardly be told apart by these data ({known}): {', '.join(weakest)}"
    )


# --- a run -----------------------------------------------------------------------------------------------------------


def _coarse_steps(apart: float | None, needed: int | None) -> str:
    mend = "no number of steps that was tried is enough: the plant jumps, explodes or is too fast for <env.dt>"
    if needed is not None:
        mend = f"so give {setting('env.substeps', needed)}, or a shorter <env.dt>"
    ends = "at no number" if apart is None else f"{apart:.2g} ranges of a state elsewhere"
    return f"the simulation of the plant is coarse: with twice as many steps a control period ends {ends}, {mend}"


def _tracked(
    outputs: Mapping[str, Mapping[str, Any]],
    within: float,
    lost: float,
    away: Mapping[str, Mapping[str, Any]],
    idle: Sequence[str],
    ringing: Sequence[str],
    grew: bool | None = None,
    seconds: float | None = None,
    rates: Sequence[str] = (),
    targets: Mapping[str, Sequence[float]] | None = None,
    moving: bool = False,
) -> str:
    texts = []
    for name, each in outputs.items():
        both = " to ".join(dict.fromkeys(map(_percent, (each["least"], each["most"]))))  # one where they are alike
        reference = "of a turn" if each["of_turn"] else "of the target range"
        reference = "of its reference's range" if moving else reference
        texts.append(f"{name} {both} {reference} on average, {_percent(each['worst'])} at worst")
    end = "the end" if seconds is None else f"the end of simulations of {format_duration(seconds)}"
    limits = f"limits: {_percent(within)} on average, {_percent(lost)} at worst"
    limits = f"limit, as targets move: {_percent(lost)}" if moving else limits
    parts = [f"errors at {end}: {'; '.join(texts)} ({limits})"]
    if not outputs:
        parts = ["the task names no targets, so nothing is said of control"]
        if grew is not None:
            parts += [f"the mean return {'grew' if grew else 'did not grow'} beside that of the untrained policy"]
    for swings, fate in ((False, "running away or without rest"), (True, "without rest")):
        shares = {name: each["share"] for name, each in away.items() if each["swings"] == swings}
        if shares:
            parts.append(
                f"not tracked, and {fate} in up to {_percent(max(shares.values()))} of the runs: {_few(shares)}"
            )
    if targets:
        low, high = ([*(ends[k] for ends in targets.values()), *(0.0 for _ in rates)] for k in (0, 1))
        names = [*targets, *rates]
        words = [setting("plant.outputs", names), setting("plant.low", low), setting("plant.high", high)]
        if not _words_of_commands:
            words = [setting("plan.task", dict(zip(names, zip(low, high, strict=True), strict=True)))]
        parts += [f"it helps to track {' and '.join(rates)} as well, which are 0 at rest: {' '.join(words)}"]
    parts += [f"still ringing, decaying: {_few(ringing)}"] if ringing else []
    parts += [f"running on, which nothing depends on: {_few(idle)}"] if idle else []
    return "; ".join(parts)


def _few(names: Iterable[str]) -> str:
    first = [*names]
    more = len(first) - FEW
    return ", ".join(first) if more <= 1 else f"{', '.join(first[:FEW])} and {more} more"


def _percent(share: float | None) -> str:
    if share is None or not math.isfinite(share):
        return "no number"
    return f"{float(f'{100 * share:.2g}'):,g} %"


# --- what a controller will do ---------------------------------------------------------------------------------------


PERIODS = {
    "step": "the step of the model",
    "oscillation": "a fifth of {value:.3g} s, the model's fastest oscillation",
    "doubling": "a quarter of {value:.3g} s, in which a deviation of the unstable model doubles",
    "sample_oscillation": "one sample of the log, because of {value:.3g} s, the model's fastest oscillation",
    "sample_doubling": "one sample of the log, because of {value:.3g} s, in which a deviation of the model doubles",
    "settles": "as the model settles in {value:time}, with a plan {ahead} periods long",
    "samples": "ten samples of the log",
}
"""Why a control period is as long as it is."""


# --- the check of a controller ---------------------------------------------------------------------------------------


def _stability(**facts: Any) -> str:
    if not facts["unstable"]:
        return _fill(STABLE, {"neutral": False, **facts})
    ends = ENDS if math.isfinite(facts["ends"]["error"]) else "{ends[output]} runs away"
    swings = SWINGS if math.isfinite(facts["swing"]["error"]) else "{swing[output]} runs away or swings ever more"
    course = _fill(f"{ends}, and {swings}", facts)
    return _fill(AT_REST if facts["at_rest"] else UNSTABLE, {"course": course, **facts})


def _coefficients(how: str, unstable: int, plants: int, radius: float, ran_away: int, **facts: Any) -> str:
    fate = "all are stable" if not unstable else f"{unstable} {'is' if unstable == 1 else 'are'} not stable"
    size = f"a spectral radius of up to {radius:.6g}" if math.isfinite(radius) else "no equilibrium in places"
    rest = ", and the steady error is {error:.3g}{unit:unit} of {output} at most" if unstable < plants else ""
    rest += " where they are" if rest and unstable else ""
    away = f"{ran_away or 'none'} of them run{'s' * (ran_away < 2)} away in the step of steps.png"
    said = f"of {plants} plants with coefficients drawn {how}, at {{held}} targets where the model is stable"
    where = f"{said}, {fate}, with {size}{rest}; {away}"
    return _fill(f"{where}; threshold: stable, {{limit:.3g}}{{unit:unit}}", facts)


def _margin(form: str) -> Callable[..., str]:
    least, limit = form.format("{value:.4g}"), form.format("{limit:g}")

    def _said(value: float, **facts: Any) -> str:
        first = f"the least is {least}" if math.isfinite(value) else "without limit"
        text = _fill(f"{first} of {{input}} at ({{target:list}}); threshold: {limit}", {"value": value, **facts})
        return re.sub(r"(?<![\d.])1 control periods", "1 control period", text)

    return _said


STABLE = (
    "stable at {targets} of {targets} targets of {outputs:and}; largest spectral radius {radius:.6g} at ({target:list})"
    ", threshold: < 1; the slowest motion there has a time constant of {slowest:time}"
    "{neutral:?(beside a motion that neither grows nor dies out)}"
)
UNSTABLE = (
    "NOT stable at {unstable} of {targets} targets of {outputs:and}, at ({target:list}) for one, with no equilibrium "
    "at {restless} of them; simulated there for {seconds:time}, {course}; thresholds: spectral radius < 1, or swings "
    "of {swing_limit:percent}"
)
ENDS = "{ends[output]} ends within {ends[error]:.3g}{ends[unit]:unit} of its target"
SWINGS = (
    "{swing[output]} swings by {swing[error]:.3g}{swing[unit]:unit} to either side, {swing[share]:percent} of its "
    "target range, and {input} by {input_swing:.2g}"
)
AT_REST = (
    "at rest at {unstable} of {targets} targets of {outputs:and}, at ({target:list}) for one, as dry friction or a "
    "dead zone may hold the plant, but NOT stable there for movements of {swing_limit:percent} of the range, and no "
    f"margins are known; simulated there for {{seconds:time}}, {ENDS}"
)
NOISE = "noise of the sensors moves {input} by {value:.3g} (standard deviation); threshold: {limit:g}"
NO_NOISE = "not known: the file of the controller states none; that of a run with sensors=bench, or on a log, does"

_GENTLE = "Where <plant.rates> names rates, try <task.reward.rate_weight=100>, by which quick movements cost more"
_NARROWER = "Leave these few targets out: low= and high= show at once what that gains"
_VARIED = "try <planning.gain_range=0.5>, by which training varies its inputs more"
_CAREFUL = f"{_GENTLE}. On any plant, {_VARIED}"
REMEDIES = {
    "check.stability": "Narrow the targets by low= and high=, or excite the plant near these targets and train anew",
    "check.undamped": "Track it as well, by its name in <plant.outputs>",
    **dict.fromkeys((f"check.{kind}_margin" for kind in ("gain", "phase", "delay", "disk")), _CAREFUL),
    "check.gain_reduction": _CAREFUL,
    "check.noise": f"{_GENTLE}, or mend the sensor",
    "check.steady_error": "Give a longer time by seconds= if outputs still move at the end of steps.png, else narrow "
    "the targets by low= and high=",
    "check.slew": _GENTLE,
    "check.saturation": "Narrow the targets by low= and high=: these steps ask for more than the actuator has",
    "check.coefficients": f"Where a plant is not stable, {_VARIED}; else give the controller integral action",
    "check.recovery": "Switch the controller on near the middle of the targets, or give <plant.start> the range from "
    "which it is to come back, and train anew",
}
"""What may mend a finding that is weak."""


def check_lines(findings: Sequence[Finding]) -> list[str]:
    """Return a line for each finding of a check, and one that sums them up; a remedy stands behind the first it mends.

    Args:
        findings: What `dynasindy.evaluation.check.check_verdict` returned.
    """
    texts, said = [], set[str]()
    for each in findings:
        few = 3 * each.values.get("weak", math.inf) <= findings[0].values["targets"] and not each.values.get("inside")
        remedy = "" if each.severity == "note" else _NARROWER if few else REMEDIES[each.code]
        remedy = "" if remedy in said else remedy
        mark = "?" if each.values.get("known") is False else "ok" if each.severity == "note" else "WEAK"
        said.add(remedy)
        texts.append(f"{mark:<4}  {_title(each)}: {each}" + (SETTING.sub(_named, f". {remedy}") if remedy else ""))
    return [*texts, check_summary(findings)]


def _title(finding: Finding) -> str:
    return finding.code.partition(".")[2].replace("_", " ")


def check_summary(findings: Sequence[Finding]) -> str:
    """Sum a check up in a line."""
    count, bad = (findings[0].values[key] for key in ("targets", "unstable"))
    if findings[0].severity == "wrong":
        return f"In short: NOT stable at {bad} of {count} targets. Do not fly it as it is."
    weak = [_title(each) for each in findings if each.severity != "note"]
    unknown = [_title(each) for each in findings if each.values.get("known") is False]
    rest = f"weak in {len(weak)} of {len(findings)} findings: {', '.join(weak)}" if weak else "no finding is weak"
    rest += f"; not known: {', '.join(unknown)}" if unknown else ""
    at_rest = findings[0].values.get("at_rest")
    swings = f", {'at rest but not stable' if at_rest else 'and swings a little'} at {bad}" if bad else ""
    return f"In short: stable at {count - bad} of {count} target{'s' * (count > 1)}{swings}; {rest}."


SENTENCES: dict[str, str | Callable[..., str]] = {
    # reading
    "log.long_format": "each row holds one signal; each of them has a column: {signals:list}",
    "log.title_lines": "{count:# line|# lines} above the headings {count:was|were} skipped",
    "log.sheet": "the sheet {sheet} is read, which holds most; left out: {others:list}",
    "log.other_lengths": "left out, as no columns of {length} real numbers: {names:list}",
    "log.second_clock": "{columns:list} of the clock {clocks:list} stand at the times of {first}",
    "log.no_time": "the file has no column of time, and its rows are taken as even",
    "log.words": "line {line}, column {column!r} holds {text!r}; {count:# cell that is no number counts|"
    "# cells that are no numbers count} as missing",
    "log.left_out": _left_out,
    "log.time": lambda column, unit, dates, dt: (
        f"time is the column {column}, {'read as dates' if dates else f'in {unit}' if unit else 'taken as seconds'}"
        + f": {dt:.4g} s between rows" * bool(dt)
    ),
    "log.coarse_clock": "the ticks of {column} are coarse, and rows are taken as even, {dt:.6g} s apart",
    "log.overflow": "the time counts to {size:g} and goes on from 0 in line {lines:list}",
    "log.sorted": "the time goes back {count:once|# times}, first in line {line}; the rows were put in its order",
    "log.restart": "the time begins anew in line {lines:list}, and so does a recording",
    "log.whole_seconds": lambda column: (
        f"{column} holds whole numbers without a unit: of a counter of rows give the true time between two in seconds, "
        f"such as {setting('data.dt', 0.01)}, of a time its unit: {setting('data.time', f'{column} [ms]')}, or [s]"
    ),
    "log.row_counter": "time is the column {column}, taken as a counter of rows, {dt:g} s apart by <data.dt>",
    "log.zero_order_hold": "{column} stands in {rows} of {total} rows, and is held from each to the next",
    "log.missing": lambda rows, total, counts, line, skipped: (
        f"{rows} of {total} rows, the first in line {line}, lack "
        f"{', '.join(f'{name} ({count})' for name, count in counts.items())}, or have no finite number there; "
        + ("they were skipped" if skipped else "the fit goes on with what else they hold")
    ),
    "log.copies": "{count:# row is the one before|# rows are those before them} once more, the first in line {line}, "
    "and left out",
    "log.code": "{column} is {value:g} in {count:# row|# rows} from line {line} on, far off all others, and left out",
    "log.spikes": "{count:a single sample|# single samples} of {state}, {count:in|the first in} line {line}, "
    "{count:is|are} far off its course and {count:counts|count} as missing",
    "log.unwrapped": "{state} jumps {times:once|# times} by {turn:.6g} and was unwrapped, as a controller has to do"
    "{counts:|; a unit that is none of an angle keeps it as it is}",
    "log.jumps": lambda states, **facts: _fill(
        "{state} jumps {times:once|# times} by up to {size:.4g}, first after {after:.6g} s, and else moves by at most "
        "{usual:.4g} from row to row. "
        + ("If it goes round, give the length of a turn, here 1 / scale: {states:data.states}; if" if states else "If")
        + " it was set anew, or its unit changed, split the log there",
        {"states": states, **facts},
    ),
    "log.long_gap": "{rows} rows in stretches of more than {longest:g} rows without {state} were left out",
    "log.gaps": "{count:# gap|# gaps} longer than 1.5 sampling times {count:splits|split} the recording",
    "log.resampled": "{count} of {total} sampling times are not {dt:g} s; states were resampled by splines, inputs, "
    "taken as held, by means. If only the times were written late, give a counter as the time and {dt:data.dt}",
    "log.stop": "{count:# sample|# samples} with {state} at {value:g}, a stop or saturation, {count:was|were} masked",
    "log.followed": "{columns:list} move in steps that another column follows, and are left out as references; if they "
    "are states, give {states:data.states}",
    "log.held_states": "{states:list} stand still in most rows, as commands do, sensors that failed, and samples "
    "that are repeated; name commands in <data.inputs>, and write repeated samples as empty cells",
    "log.guessed_inputs": "taken as input by {named:name, as other columns follow|steps, where all others move in "
    "most rows}: {inputs:list}; if that is wrong, correct {inputs:data.inputs} and {states:data.states}",
    "log.unmeasured": "{state} is seen by no sensor; it is estimated with the model",
    "log.converted": lambda units, kept: (
        f"converted: {', '.join(f'{name} from {old} to {new}' for name, (old, new) in units.items())}, as targets, "
        f"limits and what a controller reads are then; {setting('data.states', kept)} would keep the file's units"
    ),
    "log.two_levels": "the log shows only two levels of input {input}, {low:g} and {high:g}, and a controller uses "
    "those between: log some, too; where the actuator can only switch, pulse it and log its share of time",
    "log.hardly_moved": "input {input} goes from {least:.6g} to {most:.6g}, {percent:.1g} % of what its actuator is "
    "taken to reach, {low:g} to {high:g}: what a model says beyond a log is a guess. Check units, log more of it, or "
    "give its ends: {inputs:data.inputs}",
    "log.beyond_ends": "input {input} goes from {least:g} to {most:g}, beyond the [-1, 1] of a plant's inputs; the "
    "model holds for these numbers, or give its ends, low and high, in <data.inputs>",
    "log.one_sided": "input {input} goes from {least:g} to {most:g}; its actuator is taken to reach from -1 to 1. If "
    "it does not, as a valve from 0 to 1, say so: {inputs:data.inputs}",
    "log.scaled": "{input} is taken into [-1, 1], where planning needs it: 0 is {rest:.6g}{unit:unit}, 1 is "
    "{one:.6g}{unit:unit}; a controller keeps it from {low:.6g} to {high:.6g}{unit:unit}",
    "log.guessed_ends": "these limits are guessed from the least and largest values in the log, of inputs with like "
    "names together. If an actuator reaches further, or rests elsewhere, correct them here; low: -1, high: 1 leaves an "
    "input unscaled: {inputs:data.inputs}",
    "log.resolution": "{state} is read in steps of {step:.3g}{unit:unit}{coarse:?(a sensor that cuts off reads half a "
    "step too low, which no standard error tells)}",
    "log.repeats": "the log repeats itself every {seconds:time}, so what was kept from the fit is like what it saw and "
    "tells little of the model: judge it on another log",
    "log.low_signal": _quiet,
    "log.touched_stop": "{count:# sample|# samples} that touched a stop {count:was|were} left out",
    "log.rate_contradicted": "{rate} was given as the rate of {state}, which the log contradicts: {state} does not "
    "move by its integral (correlation {correlation:.2f}); correct <plant.known> or the columns",
    "log.rate_exchanged": "{rate} was given as the rate of {state}, and in the log it is the other way round; give "
    "{known:plant.known}, or correct the columns",
    # logs that cannot be read
    "log.no_roles": _no_roles,
    "log.too_few": lambda path, count, least, left_out, state="": (
        f"{path} gives {count} {f'samples of {state}' if state else 'transitions'}; allowed are {least} or more: log "
        f"longer.{_taken(left_out)}"
    ),
    "log.column_without_numbers": "the column {column} holds no number: log what it should hold, or leave it out; rows "
    "without a time are even where <data.dt> is given",
    "log.worded_column": "the column {column} holds words, such as {text!r}; allowed are numbers, 1 and 0 for UP and "
    "DOWN, and of time dates such as 2024-05-31 12:00:00.05 or 31.05.2024 12:00:00.05: write them so",
    "log.name": "a state or input is called {name!r}; allowed are names that begin with a letter, hold no signs of "
    "arithmetic and differ, each of a column of its own: name it in <data.states> or <data.inputs>, as "
    "{{angle: HEADING}}",
    "log.time_named": "the column {column} is the time and can be neither a state nor an input: leave it out of "
    "<data.states> and <data.inputs>, or say by <data.time> which other column is the time",
    "log.time_order": "line {line}, column {column}: {after:.12g} s follows {before:.12g} s; allowed is increasing "
    "time: sort the rows or split the recordings, or give <data.dt> if the clock is coarser than the rows",
    "log.time_unit": "the time column {column!r} is in {unit!r}; allowed units are {units:list}, or none for s",
    "log.coarse_time": "time moves in ticks of {tick:g} s, one or more from row to row, which does not tell the "
    "sampling time: write it with more digits, or give the time between two rows in seconds as <data.dt>",
    "log.no_time_unit": lambda column, step: (
        f"numbers without a unit stand in the time column {column}, {step:g} from row to row, hardly seconds: give "
        f"their unit, as in {setting('data.time', f'{column} [us]')}, or [s] for seconds, or [ms], or write "
        "dates, such as 2024-05-31 12:00:00.05"
    ),
    "log.uneven": "no stretch of the recording has 4 samples {dt:g} s apart, which are needed: check the sampling time",
    "log.constant_input": "input {input} is constant at {value:g}: excite it, or leave it out of <data.inputs>",
    "log.input_ends": "input {input} was given low {low:g} and high {high:g}, its column goes from {least:.6g} to "
    "{most:.6g} after scaling; allowed are ends that hold all of it: give low, high and scale of one unit",
    "log.rate_units": _rate_units,
    # the fit
    "fit.identifiability": _identifiability,
    "fit.standard_errors": "coefficients{of_step:?of the change over a step} are known within {median:.2g} % of "
    "themselves in the median, and that of {least}, the least of all, within {worst:.2g} % (standard errors)",
    "fit.unscaled": "no sensor sees {states:and}, and nothing tells its unit: in any other one the model predicts the "
    "same. It is about that of the first guess",
    "fit.trajectories": "the fit compares whole simulations with the log and not single steps, as sensors seem to be "
    "noisy{unmeasured:?or to lack states}",
    "fit.single_steps": "the fit predicts each sample from the one before, as errors do not look like noise of sensors",
    "fit.dropped": "the refinement dropped every function, so the fit before it stays; log longer or cleaner data",
    "fit.chosen_on": "functions were chosen on {rows} of {total} rows, in {stretches:one stretch|# stretches}, then "
    "all were fitted",
    "fit.fitted_to": "the coefficients were fitted on {rows} of {total} rows, in {stretches:one stretch|# stretches}",
    "fit.stride": "the fit reads one sample of {stride}, as linear equations then predict better",
    "fit.longest_delay": lambda seconds: (
        f"the best delay of the inputs is the longest that was tried, {seconds:g} s: give "
        f"{setting('longest_delay', float(f'{2 * seconds:g}'))}, or 0 where it stands for what the equations lack. "
        "Standard errors take the delay as right"
    ),
    "fit.multiple_shooting": "the fit simulates pieces of {samples} samples, as the whole log runs away",
    "fit.shorter_shooting": "the fit simulates pieces of {short} samples, as the model runs away in those of {long}",
    "fit.steps": "the plant moves in steps: at the end of the data the error of difference equations grows by "
    "{error:.2g} ranges a second in a period, that of differential equations by {continuous:.2g}",
    "fit.library_cut": "of the {whole} functions of library {library} {kept} were taken, the simplest ones and those "
    "that explain most, as {samples} samples tell no more; log longer, or name the functions that move the plant",
    "fit.shape": "the number in {function} stayed at its first guess {guess:g}: the data hardly determine it",
    "fit.candidates": "{count:the one model that was tried predicts|of # models tried this one predicts best} up "
    "to {seconds:time} ahead in parts of the training data that the fit had not seen",
    "fit.added_rates": "no sensor sees {states:and}, by which the model predicts better; {known:plant.known} leaves "
    "rates out",
    "fit.linear_inputs": "taken to move in straight lines between samples, not to be held, as the model then predicts "
    "better: {inputs:and}",
    "fit.disturbance": "no sensor sees {state}, which pushes the plant at random and fades within {seconds:.3g} s; it "
    "is estimated from past samples, and with it the model predicts better",
    "fit.hidden_states": "no sensor sees {states:and}, added by a linear model and estimated from past samples; with "
    "them the model predicts better",
    "fit.behind": "{state} up to {seconds:time} ahead was predicted {factor:.3g} times as well by the best simple "
    "model, of past samples (ARX) or the last value held, in parts of the training data that the fit had not seen",
    "fit.budget": "the search ended after {seconds:.0f} s of computing{stopped:?(it was stopped)}; the best model "
    "until then was kept. For a longer one give more <world_model.refinement.seconds>",
    # the model
    "model.delay": "the inputs act {seconds:time} later than the equations say: a delay, or a lag of about that",
    "model.dry_friction": "{state}' has dry friction",
    "model.lag_state": "{state}, seen by no sensor, follows {signal} with a time constant of {seconds:.3g} s",
    "model.idle_state": "{states:and} stand in no equation; what no sensor sees needs a first guess of the equations, "
    "as in {initial:plant.initial}, with numbers of your plant",
    "model.predicts": lambda seconds, exact, behind: (
        f"{'even so, ' * behind}this model predicts {format_duration(seconds)} ahead"
        + f", and {', '.join(exact)} as exactly as the sensors can tell" * bool(exact)
    ),
    "model.incomplete": "this model is better than the last value held for {seconds:time}, but it lacks something",
    "model.runs_away": "this model does not predict: within {seconds:time} it runs away in {states:list}",
    "model.misses": lambda seconds, errors, units, held: (
        f"this model does not predict: over {format_duration(seconds)} it misses "
        + ", ".join(f"{name} by {error_of(error)}{FORMATS['unit'](units[name])}" for name, error in errors.items())
        + f"; the last value held misses {', '.join(map(error_of, held.values()))}"
    ),
    "model.unstable_plant": lambda states, seconds: (
        f"a linear model on past samples lets {' and '.join(states)} run away, too, as a falling pole does"
        + f"; for {format_duration(seconds)} this model has half of the error of the last value held" * bool(seconds)
    ),
    "model.linear_better": "a linear model on past samples predicts {state} {seconds:time} ahead to {linear:error}"
    "{unit:unit}, this one to {error:error}: a function may be missing, or a state that no sensor sees",
    "model.leave_out": "leave out what is no part of the plant, as a temperature beside it; without {states:and}: "
    "{kept:data.states}",
    "model.unexplained": "of the changes from sample to sample the model misses {shares:shares}: its library lacks a "
    "function, or the plant has a state that is not measured",
    "model.short_validation": "the validation data are too short to judge how far ahead the model predicts",
    "observer.lost": "errors of {states:list} grow so much within {seconds:time} that no observer follows the log; "
    "leave out by <data.states> what follows other columns at once, as a motor's current does its voltage and speed",
    "model.uncontrolled": "in the equations that were found no input moves {outputs:list}, so nothing can be planned; "
    "record longer, and let every input change often and by much",
    # the check of a controller
    "check.stability": _stability,
    "check.undamped": "at ({target:list}) {state} swings for ever, once in {seconds:time}; threshold: any damping",
    "check.gain_margin": _margin("{}"),
    "check.gain_reduction": _margin("1/{}"),
    "check.phase_margin": _margin("{} deg"),
    "check.delay_margin": _margin("{} control periods"),
    "check.disk_margin": _margin("{}"),
    "control.thin_margin": "the loop has a disk margin of {value:.2g} at ({target:list}), by {input}, where {limit:g} "
    "or more is robust: a check tells more of it, and what helps",
    "control.dry_friction": "margins are those of movements of a hundredth of the ranges, which the dry friction of "
    "{states:list} damps; larger ones may stand less delay and gain",
    "check.noise": lambda known=True, **facts: _fill(NOISE if known else NO_NOISE, facts),
    "check.steady_error": "in steps from {begin} at most {error:.3g}{unit:unit} of {output}; threshold: "
    "{limit:.3g}{unit:unit}",
    "check.slew": "in steps from {begin} {input} changes by up to {value:.3g} from one control period to the next; "
    "threshold: {limit:g}",
    "check.saturation": "in steps from {begin} {input} is at its limit for up to {value:percent} of {seconds:time}; "
    "threshold: {limit:percent}",
    "check.coefficients": _coefficients,
    "check.recovery": "of {tried} initial errors each, of up to {reach:|# times }the typical size of each state, the "
    "loop comes back from {shares:shares} (or from that share of the smaller ones, if it is less), and rests within "
    "{error:.3g}{unit:unit} of the target of {output}; threshold: {limit:percent}",
    # a run
    "plant.coarse_steps": _coarse_steps,
    "plant.longer_episodes": "episodes have {steps} control periods (<task.max_steps>), and the environment is "
    "registered with {registered}, a limit that does not hold here",
    "excitation.restarts": lambda times, beyond: (
        _fill("the excitation began anew at the start {times:once|# times}: ", {"times": times})
        + ", ".join(
            _fill("{state} beyond {low:g} to {high:g}{unit:unit}, {times:once|# times}", each) for each in beyond
        )
        + "an episode was over" * (not beyond)
    ),
    "excitation.stops": "the excitation reached a mechanical stop in {count} of {total} control periods; the model is "
    "fitted to the others{much:?(a smaller <excitation.amplitude>, or another <excitation.offset>, leaves more)}",
    "run.ended": "the environment itself ended {runs} of {total} runs; a plan keeps away from what ends them within "
    "{bounds:plant.bounds}",
    "run.better": "the trained policy is better than the untrained one: its return in scenario '{scenario}' is "
    "{trained:.6g}, the untrained policy's {untrained:.6g}",
    "run.no_better": "no usable result: the trained policy's return in scenario '{scenario}' is {trained:.6g}, the "
    "untrained one's {untrained:.6g}; check plant and reward, or train longer{episodes:?and look in gate.csv}",
    "run.tracked": lambda controlled, **facts: f"{WORDS[controlled]}: {_tracked(**facts)}",
    "run.gate_closed": "the model was not trusted, so that nothing was planned on it, after {closed} of {episodes} "
    "episodes: after episode {episode} its error on real periods that it was not fitted to was {error:.2g} of reward "
    "per control period ({open_below:gate.open_below}, {close_above:gate.close_above}); gate.csv tells of each",
    # what a controller will do
    "forecast.tracked": lambda controlled, **facts: _tracked(**facts),
    "forecast.runs_away": "models that run away: {models} of {of}",
    "forecast.static_friction": lambda outputs: (
        "if dry friction at rest is twice that of motion, of which a log tells little, "
        + "; ".join(
            f"{name} {_percent(mean)} on average, {_percent(worst)} at worst" for name, (mean, worst) in outputs.items()
        )
    ),
    "forecast.no_equilibrium": "{targets}: give a smaller range of targets, or log and use more of the inputs' range",
    "forecast.models_differ": "what the log leaves open decides whether models are held: log longer, let the inputs "
    "change more often and more widely, or name functions and states that the model lacks",
    "forecast.pushed": "all targets are held without the disturbances seen in the log: reduce them (vibration, noise "
    "of sensors), or ask for a wider range of targets, of which errors are shares",
    "forecast.longer_plan": "a longer plan, or a smaller range of targets, may hold it",
    "forecast.short_log": "half of what the plan does not see of the log has {samples} samples, fewer than the "
    "{functions} functions of the equations, which tells nothing: log longer, or choose a smaller library",
    "forecast.beyond_log": "the targets of {state} go from {low:g} to {high:g}{unit:unit}, the log from "
    "{least:.3g} to {most:.3g}: what the equations say so far beyond is a guess, so log it there, or give targets "
    "nearer to the log",
    "forecast.beyond_inputs": "flights take {input} from {low:.2g} to {high:.2g}, the log tells of {least:.2g} to "
    "{most:.2g}, and the equations are not linear in it: plan with the log, or log all of the range",
    "control.period": lambda cause, **facts: _fill(
        f"the control period is {{seconds:g}} s, {PERIODS[cause]}; <env.dt> chooses another one", facts
    ),
    "control.sampled": "the control period is {seconds:g} s, the multiple of the log's sampling time of {step:g} s "
    "that is nearest to {wanted:env.dt}",
    "control.restless": "at rest {input} still changes by {percent:.2g} % of its range from period to period, on "
    "average: see that the actuator stands it",
    "control.beyond_targets": "references of {output} in scenario '{scenario}' go from {least:.3g} to "
    "{most:.3g}{unit:unit}, and the controller was made for {low:.3g} to {high:.3g}{unit:unit}: if it is to follow "
    "these, make one for a wider range of targets",
}
"""What is said of each finding: a template, or a function of its values."""
