"""Export a controller and its model: `python scripts/export.py run=PATH 'formats=[c,onnx,fmu,model]' [folder=PATH]`."""

from pathlib import Path
from typing import Any

from cli import command


@command("export")
def main(cfg: Any) -> None:
    """Write the files, and print what each is and takes."""
    from dynasindy.export.write import read, write
    from dynasindy.progress import say
    from dynasindy.safe_io import output_folder

    run = Path(cfg.run)
    controller, model = read(run)
    folder = output_folder(run, "export", cfg.folder)
    say(*write(controller, model, folder, cfg.formats, cfg.fmi), f"Files: {folder}")


if __name__ == "__main__":
    main()
