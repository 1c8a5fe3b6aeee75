"""Export a controller and its model: `python scripts/export.py run=PATH 'formats=[c,onnx,fmu,model]' [folder=PATH]`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cli import command

if TYPE_CHECKING:
    from omegaconf import DictConfig


@command("export")
def main(cfg: DictConfig) -> None:
    """Write the files, and print what each is and takes."""
    import torch

    from dynasindy.export.write import Exported, write
    from dynasindy.progress import say
    from dynasindy.safe_io import output_folder

    torch.set_num_threads(cfg.threads)
    if cfg.run is None:
        raise ValueError("run is not given; give run=PATH, a run folder, a controller.json or a model.json")
    run = Path(cfg.run)
    exported = Exported.read(run)
    folder = output_folder(run, "export", cfg.folder)
    say(*write(exported, folder, cfg.formats, cfg.fmi), f"Files: {folder}")


if __name__ == "__main__":
    main()
