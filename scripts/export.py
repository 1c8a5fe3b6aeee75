"""Export a controller and its model: `python scripts/export.py run=PATH 'formats=[c,onnx,fmu,model]' [folder=PATH]`."""

from pathlib import Path

import torch
from command import command
from omegaconf import DictConfig

from dynasindy.evaluation.given import own_folder, refuse_links
from dynasindy.export.write import Exported, write


@command("export")
def main(cfg: DictConfig) -> None:
    """Write the files, and print what each is and takes."""
    torch.set_num_threads(cfg.threads)
    if cfg.run is None:
        raise ValueError("run is not given; give run=PATH, a run folder, a controller.json or a model.json")
    run = Path(cfg.run)
    exported = Exported.read(run)
    if cfg.folder is None:
        folder = own_folder(run if run.is_dir() else run.parent, "export")
    else:
        folder = Path(cfg.folder)
        refuse_links(folder)
    for line in write(exported, folder, cfg.formats, cfg.fmi):
        print(line)
    print(f"Files: {folder}")


if __name__ == "__main__":
    main()
