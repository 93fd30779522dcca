"""An interrupt ends a command, even where a library that is being imported swallows it."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

AGAIN_S = 0.5  # until an interrupt that was swallowed is repeated


@contextmanager
def interruptible() -> Iterator[None]:
    """An interrupt is repeated until it has reached this place, or somebody tidies up after it."""
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


def calm() -> None:
    """No more repetitions: whoever calls this got the interrupt and is about to tidy up after it."""
    with suppress(ValueError):
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
    raise KeyboardInterrupt
