"""Output folders: what a command writes appears whole or not at all, and takes the place of what an earlier run left there.

A folder is filled out of sight, in one called ``.NAME-<16 hexadecimal digits>.part`` beside it (inside it, where it exists), and
then put in place. The process that fills it holds a lock on it; one that nobody holds was left by a run that was killed, and the
next run takes it away.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import fnmatch
import json
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rx90b_flex.files.keys import shortened
from rx90b_flex.files.toml import read_toml
from rx90b_flex.interrupts import calm


@dataclass(frozen=True)
class Output:
    """What a command leaves in a folder.

    Attributes
    ----------
    mark : str
        The file by which a result is known as one. It is put in place last and taken away first, so that there is none beside
        files that do not belong to it.
    names : tuple of str
        Patterns of all other names.
    replaced : bool
        Whether the next run may take the place of it without being told to.
    recordings : bool
        Whether the recordings that its campaign file lists are its own, too.
    """

    mark: str
    names: tuple[str, ...]
    replaced: bool = True
    recordings: bool = False

    def own(self, folder: Path) -> set[str]:
        """Names in a folder that are of this output."""
        patterns = (self.mark, *self.names)
        found = {name for name in os.listdir(folder) if any(fnmatch.fnmatchcase(name, p) for p in patterns)}
        campaign = folder / "campaign.toml"
        if self.recordings and campaign.is_file() and not campaign.is_symlink():
            listed = re.findall(r'^file = "([^"/\\]+)"$', campaign.read_text(errors="replace"), re.MULTILINE)
            found |= {name for name in listed if os.path.lexists(folder / name)}
        return found


_MODEL = ("report.html", "robot.toml", "robot.urdf")
CLOSED_LOOP = Output("closed_loop.json", (*_MODEL, "motion.json", "prediction_*.csv"))
IDENTIFIED = Output("identification.json", (*_MODEL, "prediction_*.csv"))
CHECKED = Output("check.json", ("check.html",))
MOTOR_SIGNALS = Output("frf.json", _MODEL)
_PATHS = ("seam.csv", "corrected_path.csv", "corrected_joints.csv", "measured.json", "measured.csv")
PATH_CHECK = Output("path_check.json", ("report.html", *_PATHS, "as_planned", "corrected"))
RUN = Output(
    "state.parquet", ("campaign.toml", "robot.toml", "robot.urdf", "tip.csv", "tip.png", "tip.svg"), recordings=True
)
STATIC = Output("static.json", _MODEL)
CAMERA = Output("camera.json", _MODEL)
FLEET = Output("fleet.json", ("fleet.csv", "fleet.html"))
RESULTS = (CHECKED, CLOSED_LOOP, IDENTIFIED, MOTOR_SIGNALS, PATH_CHECK, RUN, STATIC, CAMERA)
DEMONSTRATION = Output(
    "declared.toml", (CLOSED_LOOP.mark, *CLOSED_LOOP.names, "campaign.toml", "*.urdf", "run_?.csv.gz")
)
# a campaign may hold what somebody measured
CAMPAIGN = Output("campaign.toml", ("references", "logs", "controller.toml"), replaced=False)
FOLDERS = ("as_planned", "corrected", "references", "logs")
_PART = re.compile(r"-[0-9a-f]{16}\.part")


def fill_folder(folder: Path, fill: Callable[[Path], None], output: Output, overwrite: bool = False) -> None:
    """Have a folder filled out of sight, then put it in place.

    Where the folder exists, what an earlier run left in it (see `Output`) is taken away as a whole; other files stay. Two runs at
    once: what is put in place last stays, whole.

    Parameters
    ----------
    folder : Path
    fill : callable
        Is given the folder to fill.
    output : Output
        What is written.
    overwrite : bool
        Whether what has a name that is needed may be taken away even where no earlier run wrote it.

    Raises
    ------
    ValueError
        One line that names the folder: it cannot be written, is full, or something is in the way.
    """
    check_folder(folder, output, overwrite)
    place = Path(os.path.realpath(folder))
    made = [p for p in place.parents if not p.exists()]
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with _part(place if place.is_dir() else place.parent, place.name) as part:
            (part / "new").mkdir()
            fill(part / "new")
            _sync(part / "new")
            with _locked(place.parent):
                _put_in_place(place, part, output, overwrite)
    except BaseException as error:
        for parent in made:
            if parent.exists() and not any(parent.iterdir()):
                parent.rmdir()
        if isinstance(error, OSError):
            raise ValueError(f"{shortened(folder)}: cannot be written: {why(error)}") from error
        raise


def check_folder(folder: Path, output: Output, overwrite: bool = False, reads: Sequence[Path | str] = ()) -> None:
    """Refuse an output folder that cannot be written, or that holds something in the way, before any work is done.

    `reads` are the files and folders that the run reads: what it writes must not take their place.
    """
    try:
        if folder.is_symlink() and not folder.exists():
            raise ValueError(f"{folder}: is a link to {os.readlink(folder)}, which does not exist; expected a folder")
        if folder.exists() and not folder.is_dir():
            raise ValueError(f"{folder}: is a file; expected a folder to write into")
        existing = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
        if not existing.is_dir():
            raise ValueError(f"{folder}: {existing} is a file; expected a folder to write into")
        refuse_unwritable(existing)
        if max(len(os.fsencode(part)) for part in folder.absolute().parts) > os.pathconf(existing, "PC_NAME_MAX") - 40:
            raise ValueError(f"{str(folder)[:60]}...: the name is too long for a folder")
        if folder.is_dir():
            place = Path(os.path.realpath(folder))
            _refuse_what_is_in_the_way(place, output.own(place), output, overwrite)
            refuse_reading(folder, output, reads)
    except OSError as error:
        raise ValueError(f"{shortened(folder)}: cannot be written: {why(error)}") from None


def refuse_reading(folder: Path, output: Output, reads: Sequence[Path | str]) -> None:
    """Refuse an output folder in which what a run writes would take the place of a file that it reads.

    Raises
    ------
    ValueError
        One line that names both.
    """
    place = Path(os.path.realpath(folder))
    going = output.own(place) | _earlier(place, output) if place.is_dir() else set()
    for read in (Path(os.path.realpath(r)) for r in reads):
        if read == place or (read.parent == place and read.name in going):
            raise ValueError(f"{shortened(folder)}: holds {read.name}, which this run reads; give another folder")


def files_read(source: Path) -> list[Path]:
    """A file and what it names, as far as that can be read: a campaign's robot file, with URDF and controller, and recordings.

    Of a folder of `rx90b-flex simulate` what is of the run.
    """
    if source.is_dir():
        return [source / name for name in RUN.own(source)]
    out, stated = [source], _table(source)
    listed = stated.get("recording")
    recordings = [r for r in listed if isinstance(r, dict)] if isinstance(listed, list) else []
    named = [stated.get("robot"), stated.get("urdf"), *(r.get("file") for r in recordings)]
    out += [source.parent / name for name in named if isinstance(name, str)]
    for robot in [p for p in out[1:] if p.suffix == ".toml"]:
        more = [_table(robot).get(key) for key in ("urdf", "controller")]
        out += [robot.parent / name for name in more if isinstance(name, str)]
    return [p for p in out if p.exists()]


def _table(path: Path) -> dict[str, Any]:
    """Of a file that may hold no TOML: nothing then."""
    try:
        return read_toml(path, "file")
    except (OSError, ValueError):
        return {}


def refuse_unwritable(folder: Path) -> None:
    """Try it with a file that has no name: rights alone say nothing of a disk that is mounted to be read.

    Raises
    ------
    OSError
        What the system says.
    """
    with tempfile.TemporaryFile(dir=folder):
        pass


def claimed(folder: Path, note: str, what: str) -> Any:
    """The digest that a folder's note holds; None where there is no note. See `claim`.

    Raises
    ------
    ValueError
        One line that names a note that cannot be read.
    """
    file = folder / note
    if not file.exists():
        return None
    try:
        return json.loads(file.read_text(encoding="utf-8"))["digest"]
    except (OSError, ValueError, KeyError, TypeError):
        raise ValueError(f"{file}: cannot be read; expected the plan of this folder's {what}") from None


def claim(folder: Path, note: str, digest: Any, summary: Mapping[str, Any]) -> None:
    """Make a folder that of some runs, so that what is there of them is kept when they are run again.

    Parameters
    ----------
    folder : Path
        Made where it does not exist.
    note : str
        Name of a JSON file, which appears whole or not at all.
    digest : str or dict
        Of everything that decides the runs.
    summary : mapping
        What the note says besides.
    """
    folder.mkdir(parents=True, exist_ok=True)
    part = folder / f".{note}-{secrets.token_hex(8)}.part"
    part.write_text(json.dumps({"digest": digest, **summary}, indent=2) + "\n", encoding="utf-8")
    os.replace(part, folder / note)


def why(error: OSError) -> str:
    """What the system says of an error, without the number."""
    return error.strerror or " ".join(str(error).split()) or type(error).__name__


def _earlier(folder: Path, output: Output) -> set[str]:
    """Names that earlier runs left: of each result that is there as a whole, and of one that was being put in place."""
    whole = [r for r in RESULTS if (folder / r.mark).is_file()]
    # with what is old out of sight, a run was killed while it replaced files here
    interrupted = any((part / "old").is_dir() for part in _parts(folder, folder.name))
    if output.replaced and (interrupted or (folder / output.mark).is_file()):
        whole.append(output)
    return {name for r in whole for name in r.own(folder) if not _unlike(folder / name)}


def _unlike(path: Path) -> str:
    """What stands in the way where no command has put it: a link, or a folder in a file's place."""
    if path.is_symlink():
        return "a link"
    if path.is_dir() != (path.name in FOLDERS):
        return "a folder" if path.is_dir() else "a file"
    return ""


def _refuse_what_is_in_the_way(folder: Path, needed: set[str], output: Output, overwrite: bool) -> None:
    """Names that are needed must be free, or of an earlier result."""
    if overwrite:
        return
    order = [*output.names, output.mark]
    free = sorted(needed - _earlier(folder, output))
    for name in sorted(free, key=lambda n: order.index(n) if n in order else -1):
        path = folder / name
        if path.exists() or path.is_symlink():
            kind = f", {_unlike(path)}," if _unlike(path) else ""
            # a campaign may hold measured logs: it is never replaced untold
            earlier = not output.replaced and (folder / output.mark).is_file()
            because = "and a campaign is replaced only if told so" if earlier else "which is of no earlier result"
            raise ValueError(
                f"{shortened(folder)}: has {name}{kind} already, {because}; give another folder, or --overwrite"
            )


def _put_in_place(folder: Path, part: Path, output: Output, overwrite: bool) -> None:
    """Rename what is new to where it belongs; what it replaces goes out of sight before, and back where that fails."""
    if not folder.exists():
        os.replace(part / "new", folder)
        return
    needed = {path.name for path in (part / "new").iterdir()}
    _refuse_what_is_in_the_way(folder, needed, output, overwrite)
    if part.parent != folder:  # the folder was made in the meantime, by another run
        os.replace(part, folder / part.name)
        part = folder / part.name
    going = {name for name in needed if os.path.lexists(folder / name)} | _earlier(folder, output)
    first = {r.mark for r in RESULTS}
    (part / "old").mkdir()
    moves = [(folder / name, part / "old" / name) for name in sorted(going, key=lambda n: n not in first)]
    moves += [(part / "new" / name, folder / name) for name in sorted(needed, key=lambda n: n == output.mark)]
    done: list[tuple[Path, Path]] = []
    try:
        for move in moves:
            done.append(move)
            os.replace(*move)
    except BaseException:
        calm()
        for before, after in reversed(done):
            with contextlib.suppress(OSError):
                os.replace(after, before)
        raise
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _sync(folder: Path) -> None:
    """Have the system write files to the disk, which may turn out to be full only then."""
    for path in folder.rglob("*"):
        if path.is_file():
            with path.open("rb") as file:
                os.fsync(file.fileno())


# ---- folders out of sight -------------------------------------------------------------------------------------


@contextlib.contextmanager
def _part(home: Path, name: str) -> Iterator[Path]:
    """A new folder out of sight, gone at the end; those that killed runs left in the same place go first."""
    for left in _parts(home, name):
        if not (left / "old").is_dir():  # else it still says that what lies beside it is half of a result
            _remove_if_abandoned(left)
    part, held = _new_part(home, name)
    try:
        yield part
        for left in _parts(home, name):
            _remove_if_abandoned(left)
    except KeyboardInterrupt:
        calm()
        raise
    finally:
        os.close(held)
        shutil.rmtree(part, ignore_errors=True)


def _new_part(home: Path, name: str) -> tuple[Path, int]:
    """A new folder and the lock on it; another one where a run that cleans up took it away before it was locked."""
    while True:
        part = home / f".{name}-{secrets.token_hex(8)}.part"
        part.mkdir()
        try:
            held = os.open(part, os.O_RDONLY)
        except FileNotFoundError:
            continue
        with contextlib.suppress(OSError):  # where a file system has no locks, others leave it alone as well
            fcntl.flock(held, fcntl.LOCK_EX)
        if part.is_dir():
            return part, held
        os.close(held)


def _parts(home: Path, name: str) -> list[Path]:
    start = f".{name}"
    if not home.is_dir():
        return []
    return [p for p in home.iterdir() if p.name.startswith(start) and _PART.fullmatch(p.name[len(start) :])]


def _remove_if_abandoned(part: Path) -> None:
    """Take away a folder that no process fills."""
    try:
        held = os.open(part, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(part, ignore_errors=True)
    except OSError as error:
        if error.errno not in (errno.EWOULDBLOCK, errno.EAGAIN, errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL):
            raise
    finally:
        os.close(held)


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """One run at a time puts its results in place."""
    if _PART.search(folder.name):  # out of sight, and so of one run, which holds a lock on it already
        yield
        return
    held = None
    with contextlib.suppress(OSError):  # a folder that may not be read, a file system without locks
        held = os.open(folder, os.O_RDONLY)
        fcntl.flock(held, fcntl.LOCK_EX)
    try:
        yield
    finally:
        if held is not None:
            os.close(held)
