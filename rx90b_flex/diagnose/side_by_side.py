"""Parts of a search that processes do beside each other."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
Large = TypeVar("Large")

PARTS = 4  # a process, of items that take unequal time
WORTH = 150_000  # samples of all joints from which on a search is worth processes of its own,
FEWEST, MOST = 4, 8  # cores: fewer gain what the processes' own work costs, more wait for what one process does


def worth_while(jobs: int | None, samples: int) -> int:
    """So many processes, or, where it is not said how many, one a core if there are samples and cores enough."""
    if jobs is not None:
        return jobs
    if samples < WORTH or (os.cpu_count() or 1) < FEWEST:
        return 1
    import joblib  # here, for it takes a while; it knows of cores that this process may not have

    cores = int(joblib.cpu_count())
    return min(cores, MOST) if cores >= FEWEST else 1


class SideBySide(Generic[Large]):
    """Something large and what is to be done with it, by so many processes: each reads it once.

    What comes out is the same for any number of them, to the last digit, as long as nothing that is done to one item changes what
    another one gives.
    """

    def __init__(self, large: Large, jobs: int) -> None:
        self.large, self.jobs, self._file = large, jobs, ""

    @property
    def elsewhere(self) -> bool:
        """Whether other processes work, on copies."""
        return self.jobs > 1

    def __enter__(self) -> Self:
        if self.elsewhere:
            import cloudpickle  # type: ignore[import-untyped, unused-ignore]

            handle, self._file = tempfile.mkstemp(prefix="rx90b_flex_", suffix=".search")
            with os.fdopen(handle, "wb") as file:
                cloudpickle.dump(self.large, file, protocol=5)
        return self

    def __exit__(self, *_: object) -> None:
        if self._file:
            Path(self._file).unlink(missing_ok=True)

    def each(self, work: Callable[[Large, Item], Result], items: Sequence[Item]) -> Iterator[Result]:
        """What `work` makes of each item, in their order; no more are begun than there are processes for when one is asked for."""
        if not self.elsewhere:
            yield from (work(self.large, item) for item in items)
            return
        import joblib

        for at in range(0, len(items), self.jobs):
            calls = (joblib.delayed(_at_work)(self._file, work, item) for item in items[at : at + self.jobs])
            yield from joblib.Parallel(n_jobs=self.jobs)(calls)

    def all(self, work: Callable[[Large, list[Item]], Result], items: Sequence[Item]) -> Iterator[Result]:
        """What `work` makes of parts of the items: of each by itself here, of several by other processes."""
        if not self.elsewhere:
            yield from (work(self.large, [item]) for item in items)
            return
        import joblib

        parts = [list(items[i :: PARTS * self.jobs]) for i in range(min(len(items), PARTS * self.jobs))]
        calls = (joblib.delayed(_at_work)(self._file, work, part) for part in parts)
        yield from joblib.Parallel(n_jobs=self.jobs, return_as="generator")(calls)


_LATEST: dict[str, Any] = {}  # of a process that works for another one: what it has read, by its file


def _at_work(file: str, work: Callable[[Any, Any], Any], item: Any) -> Any:
    import pickle

    from threadpoolctl import threadpool_limits

    if file not in _LATEST:
        _LATEST.clear()
        with open(file, "rb") as opened:
            _LATEST[file] = pickle.load(opened)
    with threadpool_limits(limits=1, user_api="blas"):  # sums of one order, whatever the number of processes
        return work(_LATEST[file], item)
