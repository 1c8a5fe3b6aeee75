"""Bad and odd inputs, drawn by a seed: each is accepted or costs one line that says what to mend."""

import json
import random
import re
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from configs import composed, make_parts
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

sys.path.append(str(Path(__file__).parents[1] / "scripts"))
from command import MENDABLE, in_words
from settings import check

from dynasindy.data.recording import LogReader
from dynasindy.sindy.model import SindyModel

VALUES = (
    "text", "", "1e-3", ".inf", None, [], [1, "x"], [[]], {}, {"a": 1}, -1, -0.5, 0, 1, 2.5, 10.0, 1e12, 10**15, 10**30,
    1e-12, 1e-300, 1e300, float("nan"), float("inf"), -float("inf"), True, False, "\u00e9\n\0", [1e15] * 2, ["x"] * 3,
)  # fmt: skip
CRYPTIC = re.compile(
    "not supported between|object has no attribute|object is not|unexpected keyword|NoneType|INTERNAL ASSERT|unhashable"
    "|positional argument|must be real number|unsupported operand|cannot unpack|values to unpack|not iterable|Traceback"
    "|could not convert|invalid literal|^list index|empty sequence|Expected all|cannot be interpreted"
)
EACH = {"train": 30, "identify": 15, "files": 10, "csv": 40, "model": 24}
"""Inputs of each kind."""


def leaves(node: object, key: str = "") -> Iterator[str]:
    """List the keys of a config, groups and places in lists included."""
    children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for name, child in children:
        whole = f"{key}[{name}]" if isinstance(node, list) else f"{key}.{name}".lstrip(".")
        if name != "hydra":
            yield whole
            yield from leaves(child, whole)


def mutated(cfg: DictConfig, key: str, value: object) -> DictConfig:
    changed = cfg.copy()
    OmegaConf.update(changed, key, value, merge=False, force_add=True)
    return changed


def complaint(line: str, *names: str) -> str:
    """Return what is wrong with a line of error, nothing if it is clear."""
    if "\n" in line or not line.strip():
        return "not one line"
    if found := CRYPTIC.search(line):
        return f"cryptic: {found[0]}"
    return "" if any(name in line for name in names) else f"names none of {names}"


def judged(use, command: str, *names: str) -> str:
    """Use an input and return what is wrong with how it is refused."""
    try:
        use()
    except MENDABLE as error:
        line = in_words(error)
        wrong = complaint(line, *names)
        return f"{wrong} | {line}" if wrong else ""
    except Exception as error:
        return f"traceback: {type(error).__name__}: {error}"
    return ""


def build(cfg: DictConfig) -> None:
    check(cfg)
    make_parts(cfg)


OPTIONS = (
    ("system=xi", "excitation=chirp", "planning=dyna"),
    ("system=trms33", "excitation=aprbs", "planning=nominal", "task=sine"),
    ("system=pendulum", "excitation=multisine", "scenario=square", "agent=td3_paper"),
    ("experiment=paper", "excitation=aprbs", "scenario=noise"),
    ("excitation=multisine", "world_model=oracle", "scenario=delay", "task=square", "planning=none"),
    ("excitation=chirp", "world_model=sindy_paper", "scenario=wind", "experiment=dyna"),
    ("scenario=detuned",),
)
"""Configs that have every option of every group between them."""


def named(key: str) -> list[str]:
    """Give the names by which a line may say which key is meant."""
    words = [word for word in re.split(r"[.\[\]]+", key) if word and not word.isdigit() and word != "_target_"]
    return [key, words[-1], f"{words[0]}."]


def run_through(command: str, configs: list[DictConfig], number: int, use) -> list[str]:
    rng, wrong = random.Random(number), []
    cases = [(cfg, key) for cfg in configs for key in leaves(OmegaConf.to_container(cfg, resolve=False))]
    for cfg, key in rng.choices(cases, k=number):
        value = rng.choice(VALUES)
        if said := judged(partial(use, mutated(cfg, key, value)), command, *named(key)):
            wrong.append(f"{key}={value!r}: {said}")
    return wrong


def test_settings_of_training() -> None:
    configs = [composed("train", *words) for words in OPTIONS]
    assert not run_through("train", configs, EACH["train"], build)


def test_logs(tmp_path: Path) -> None:
    rng, wrong, path = random.Random(0), [], tmp_path / "log.csv"
    head = "time [s],angle [rad],rate,u\n"
    text = head + "".join(f"{0.01 * k:.2f},{k % 7 / 7},{k % 5 - 2},{k // 5 % 3 - 1}\n" for k in range(120))
    pieces = (
        '"',
        "\n",
        "\0",
        ",",
        ";",
        "\t",
        "nan",
        "1e999",
        "-",
        "\ufeff",
        "x",
        "\r",
        "''",
        "[",
        "time",
        "9" * 50,
        "",
    )
    for _ in range(EACH["csv"]):
        bad = text
        for _ in range(rng.randint(1, 4)):
            start = rng.choice((rng.randrange(len(head)), rng.randrange(len(bad))))
            end = start + rng.choice((0, 0, 1, 3, 40, len(text)))
            bad = bad[:start] + rng.choice(pieces) * rng.choice((1, 1, 3)) + bad[end:]
        path.write_text(bad, encoding=rng.choice(("utf-8", "utf-16", "utf-16-le", "latin-1")), errors="replace")
        if said := judged(lambda: LogReader(str(path)).recording(), "identify", str(path)):
            wrong.append(f"{bad[:60]!r}: {said}")
    assert not wrong


def test_models(tmp_path: Path) -> None:
    rng, wrong, path = random.Random(1), [], tmp_path / "model.json"
    SindyModel(instantiate(composed("train").system).signature, "rotor", known={"alpha_a": "Omega_a"}).save(path)
    data, text = json.loads(path.read_text()), path.read_text()
    keys = list(leaves(data))
    for k in range(EACH["model"]):
        if k % 3:
            tree = OmegaConf.create({"model": json.loads(text)}, flags={"allow_objects": True})
            key = rng.choice(keys)
            OmegaConf.update(tree, f"model.{key}", rng.choice(VALUES), merge=False, force_add=True)
            path.write_text(json.dumps(OmegaConf.to_container(tree)["model"]))
        else:
            cut = rng.randrange(len(text))
            path.write_text(text[:cut] + text[cut + rng.choice((1, 5, len(text))) :])
        said = judged(
            lambda: SindyModel.load(path), "identify", str(path), "feature", "function", "library", "state", "unit"
        )
        if said and " is damaged (" not in said:  # which gives the reason of Python in brackets
            wrong.append(said)
    assert not wrong
