"""A single file that somebody names for what a command writes: the URDF of ``flexify`` and ``export``, the page of ``view``."""

from __future__ import annotations

import os
import re
from pathlib import Path

from rx90b_flex.signals.folders import files_read, refuse_unwritable, why
from rx90b_flex.signals.tables import write_whole

GENERATOR = re.compile(r'<meta name="generator" content="([^"]*)">')
LOOKED_AT = 2**16  # bytes at a file's beginning


def check_file(path: Path, source: str | os.PathLike[str] | None = None) -> None:
    """Refuse what is no place for a file: a folder, a device, a link to nowhere; and what is read.

    Parameters
    ----------
    path : Path
        File to write.
    source : str or path, optional
        What is read, which must not be replaced, nor what it names (`files_read`).

    Raises
    ------
    ValueError
        One line that names the path.
    """
    if os.path.lexists(path) and not path.is_file():
        kind = "a folder" if path.is_dir() else "no regular file"
        raise ValueError(f"{path} is {kind}; expected a file to write")
    try:
        refuse_unwritable(next(p for p in path.absolute().parents if p.exists()))
    except OSError as error:
        raise ValueError(f"{path}: cannot be written: {why(error)}") from None
    own = [] if source is None or not os.path.exists(source) else files_read(Path(source))
    if any(path.resolve() == file.resolve() for file in own):
        raise ValueError(f"{path}: is what this run reads; expected another file to write")


def write_file(path: Path, text: str) -> None:
    """Write text, XML or HTML, as UTF-8; the file appears whole or not at all, in a folder that is made where it is missing.

    A file that is there is replaced if it is empty or of the same kind: of the same first element and, where the text says what
    made it (``<meta name="generator">``), made by the same.

    Raises
    ------
    ValueError
        One line that names the path: it is no place for a file, is a file of another kind, or cannot be written.
    """
    try:
        check_file(path)
        there, made_by = _beginning(path), GENERATOR.search(text[:LOOKED_AT])
        if there.strip() and _root(there) != _root(text):
            raise ValueError(f"{path}: a file that does not begin with <{_root(text)}> is there; expected another name")
        if there.strip() and made_by and made_by[0] not in there:
            raise ValueError(f"{path}: a page that is no {made_by[1]} is there; expected another name")
        path.absolute().parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be written: {why(error)}") from None


def _beginning(path: Path) -> str:
    """Of what is there; nothing where no file is."""
    if not path.exists():
        return ""
    with path.open("rb") as file:
        return file.read(LOOKED_AT).decode(errors="replace")


def _root(text: str) -> str:
    """The first element of XML or HTML, or what its DOCTYPE names: ``robot``, ``html``; empty for any other text."""
    rest = text.lstrip("\ufeff \t\r\n")
    while rest.startswith(("<?", "<!--")):
        rest = rest.partition("?>" if rest.startswith("<?") else "-->")[2].lstrip()
    found = re.match(r"<(?:!doctype\s+)?([\w:.-]+)", rest, re.IGNORECASE)
    return found[1].lower() if found else ""
