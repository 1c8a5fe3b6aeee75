"""What a run leaves, in a form in which two runs can be compared."""

import csv
import json
import re

import torch


def left_by(folder, *others):
    """Return what each file of a run holds, but for the times it took, the name of its folder and some other files."""
    files = {}
    for file in sorted(file for file in folder.rglob("*") if file.is_file()):
        name = str(file.relative_to(folder))
        if "wall_seconds" in name or name in others:
            continue
        if file.suffix == ".csv":
            rows = list(csv.reader(file.open()))
            drop = [i for i, cell in enumerate(rows[0]) if cell == "wall_seconds"]
            files[name] = [[cell for i, cell in enumerate(row) if i not in drop] for row in rows]
        elif file.suffix == ".pt":
            files[name] = {key: value.tolist() for key, value in torch.load(file).items()}
        elif name == "metrics.json":
            files[name] = json.loads(file.read_text())
            del files[name]["cost"]["wall_seconds"]
        elif file.suffix in (".txt", ".yaml", ".json"):
            files[name] = re.sub(r"[0-9.e-]+ s\b|folder: .*", "", file.read_text())
        else:
            files[name] = file.read_bytes()
    return files
