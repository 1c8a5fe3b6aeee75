"""What the scripts share: a Hydra command whose user's errors are one line each."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from mistakes import CONF, MENDABLE, in_words
from omegaconf import DictConfig
from reader import while_read

# The jobs of a sweep run in processes of their own, which have to find the modules beside this one.
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(Path(__file__).parent), os.environ.get("PYTHONPATH")]))


def command(config_name: str) -> Callable[[Callable[[DictConfig], None]], Callable[[], None]]:
    """Make a function of a config a command: a bad setting or file costs one line and exit code 2.

    A run folder without files is removed; one with files keeps them, and the line, as `error.txt`. Set
    DYNASINDY_TRACEBACK=1 to see where an error comes from.
    """

    def decorate(task: Callable[[DictConfig], None]) -> Callable[[], None]:
        @wraps(task)
        def guarded(cfg: DictConfig) -> None:
            with _one_line(config_name):
                task(cfg)

        main = hydra.main(version_base="1.3", config_path=str(CONF), config_name=config_name)(guarded)

        return _one_line(config_name)(main)

    return decorate


@contextmanager
def _one_line(config_name: str) -> Iterator[None]:
    with while_read():
        try:
            yield
        except MENDABLE as error:
            if os.environ.get("DYNASINDY_TRACEBACK"):
                raise
            line = f"error: {in_words(error, config_name)}"
            _leave_word(line)
            print(line, file=sys.stderr)
            sys.exit(2)


def _leave_word(line: str) -> None:
    """Remove the run folder if it is empty; else write the line into it."""
    if not HydraConfig.initialized():
        return
    folder = Path(HydraConfig.get().runtime.output_dir)
    if not folder.is_dir() or folder.resolve() == Path.cwd():
        return
    if any(folder.iterdir()):
        (folder / "error.txt").write_text(line + "\n")
    else:
        folder.rmdir()
