"""Output folders that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path


def fill_folder(folder: Path, fill: Callable[[Path], None]) -> None:
    """Have a folder filled out of sight, then put it (or, where it exists, its files) in place."""
    made = [p for p in (folder.absolute().parent, *folder.absolute().parents) if not p.exists()]
    folder.absolute().parent.mkdir(parents=True, exist_ok=True)
    hidden = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.absolute().parent))
    try:
        fill(hidden)
        if folder.exists():
            for path in sorted(hidden.iterdir()):
                os.replace(path, folder / path.name)
            hidden.rmdir()
        else:
            hidden.chmod(0o755)
            os.replace(hidden, folder)
    except BaseException:
        shutil.rmtree(hidden, ignore_errors=True)
        for parent in made:
            if parent.exists() and not any(parent.iterdir()):
                parent.rmdir()
        raise


def check_folder(folder: Path) -> None:
    """Refuse an output folder that cannot be written, before any work is done."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: is a file; expected a folder to write into")
    existing = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    if not existing.is_dir():
        raise ValueError(f"{folder}: {existing} is a file; expected a folder to write into")
    if not os.access(existing, os.W_OK):
        raise ValueError(f"{folder}: {existing} cannot be written")
