"""How a command ends: its exit status, and one line on standard error where it could not do its work."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, Protocol

from rx90b_flex.files.extensions import blamed
from rx90b_flex.files.warned import InputWarning
from rx90b_flex.interrupts import interruptible, is_interrupt

REFUSED = 2
INTERNAL = 70  # EX_SOFTWARE of sysexits.h
INTERRUPTED = 128 + signal.SIGINT
NOBODY_READS = 128 + signal.SIGPIPE
TRACEBACK = "RX90B_FLEX_TRACEBACK"  # environment variable
LONGEST = 2000  # characters of a message


class Stopped(Exception):
    """An interrupt of what goes on when it is called again; its message says what is kept."""


class CommandLine(Protocol):
    """What a Typer application is called as."""

    def __call__(self, *, standalone_mode: bool) -> Any: ...


def run(app: CommandLine, usage_error: type[Exception], name: str) -> int:
    """Run a command line and return its exit status.

    0: done; what a command itself says otherwise, such as 1 for "not within tolerance"; 2: bad input, a full disk, too little
    memory, one line says what and where; 130: interrupted; 70: a fault of the program, whose traceback the environment variable
    ``RX90B_FLEX_TRACEBACK=1`` shows.

    Parameters
    ----------
    app : callable
    usage_error : type
        What the command-line library raises where the words of the command line are wrong.
    name : str
        Of the program, before each line.
    """
    try:
        with interruptible(), _quiet(name):
            status = app(standalone_mode=False)
            sys.stdout.flush()
        status = status if isinstance(status, int) else 0
        if status != INTERRUPTED:
            return status
        line = "interrupted; nothing was written"
    except Stopped as error:
        status, line = INTERRUPTED, str(error)
    except BaseException as error:
        aborted = type(error).__name__ == "Abort"  # what some releases of the library make of an interrupt
        if is_interrupt(error) or aborted:
            status, line = INTERRUPTED, "interrupted; nothing was written"
        elif isinstance(error, BrokenPipeError | SystemExit) and not blamed(error):
            # the library makes the second of the first
            _close_output()
            return NOBODY_READS
        elif os.environ.get(TRACEBACK) and not isinstance(error, ValueError | usage_error):
            raise
        elif type(error).__name__ == "NoArgsIsHelpError":  # its message is the help
            error.show()  # type: ignore[attr-defined]
            return REFUSED
        else:
            status, line = _status_and_words(error, usage_error)
    with suppress(OSError):
        print(f"{name}: {_one_line(line)}", file=sys.stderr, flush=True)
    if status != REFUSED:
        _close_output()
    return status


def _status_and_words(error: BaseException, usage_error: type[Exception]) -> tuple[int, str]:
    if isinstance(error, usage_error):
        return REFUSED, str(getattr(error, "format_message", error.__str__)())
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename is not None else ""
        return REFUSED, f"{where}{error.strerror or error}"
    if isinstance(error, MemoryError):
        return REFUSED, f"not enough memory: {error}" if str(error) else "not enough memory"
    try:
        package = blamed(error)
    except MemoryError:  # what is missing may be missing for this, too
        package = ""
    # of libraries, too, which derive their errors from it; but what NumPy says of an array is no word on somebody's input
    if isinstance(error, ValueError):
        return REFUSED, f"{error} (in package {package})" if package else str(error)
    if package:
        return INTERNAL, f"a fault of package {package}: {type(error).__name__}: {error} ({TRACEBACK}=1 shows where)"
    return INTERNAL, f"a fault of the program: {type(error).__name__}: {error} ({TRACEBACK}=1 shows where)"


def _one_line(text: str) -> str:
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return line if len(line) <= LONGEST else f"{line[: LONGEST // 2]} ... {line[-LONGEST // 2 :]}"


@contextmanager
def _quiet(name: str) -> Iterator[None]:
    """Warnings of libraries are for who programs, unless asked for by ``python -W`` or PYTHONWARNINGS.

    So is what Python says of errors in a library's callbacks and destructors, which nobody can catch. An `InputWarning` is a
    line, once.
    """

    told: set[str] = set()

    def line(message: Warning | str, *_: Any, **__: Any) -> None:
        if str(message) not in told:
            print(f"{name}: warning: {_one_line(str(message))}", file=sys.stderr, flush=True)
        told.add(str(message))

    said = sys.unraisablehook
    with warnings.catch_warnings():
        if not sys.warnoptions:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", InputWarning)
            warnings.showwarning = line
            sys.unraisablehook = lambda _: None
        try:
            yield
        finally:
            sys.unraisablehook = said


def _close_output() -> None:
    """Have nothing more written at the interpreter's end, which would fail again."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
