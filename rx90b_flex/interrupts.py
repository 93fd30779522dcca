"""An interrupt ends a command, even where libraries are being imported, which it may break, or which may swallow it."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

AGAIN_S = 0.5  # until an interrupt that was swallowed is repeated
IMPORT_S = 1.5  # that an import may go on after an interrupt: some libraries abort the process where one hits them
LOOK_S = 0.05  # from one look to the next whether it still goes on

_came: float | None = None  # when the interrupt came, of those since `interruptible` began the first


@contextmanager
def interruptible() -> Iterator[None]:
    """An interrupt is repeated until it has reached this place, or somebody tidies up after it."""
    global _came
    _came = None
    try:
        before = signal.signal(signal.SIGINT, _interrupt), signal.signal(signal.SIGALRM, _interrupt)
    except ValueError:  # not in the main thread, which is the one that signals reach
        yield
        return
    try:
        yield
    finally:
        calm()
        for number, handler in zip((signal.SIGINT, signal.SIGALRM), before, strict=True):
            signal.signal(number, handler)
        # or Python ends by the signal where it came in code made of a text (its `unhandled_keyboard_interrupt`)
        eval("0")


def calm() -> None:
    """No more repetitions: whoever calls this got the interrupt and is about to tidy up after it."""
    with suppress(ValueError):
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def is_interrupt(error: BaseException | None) -> bool:
    """Whether an error is an interrupt, or comes after one; also whether there was one (None).

    A library whose import was interrupted may be left half loaded: what then fails, with whatever error, fails of the interrupt.
    """
    return _came is not None or isinstance(error, KeyboardInterrupt)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """It waits for an import to end; asked for once more, it does not."""
    global _came
    first, _came = _came is None, _came or time.monotonic()
    waits = (first or number == signal.SIGALRM) and time.monotonic() < _came + IMPORT_S and _importing(frame)
    signal.setitimer(signal.ITIMER_REAL, LOOK_S if waits else AGAIN_S)
    if not waits:
        raise KeyboardInterrupt


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False
