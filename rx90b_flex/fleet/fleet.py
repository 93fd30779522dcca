"""Close the loop on the campaigns of many robots of one make, and compare them."""

from __future__ import annotations

import dataclasses
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rx90b_flex.closing import LoopOptions
from rx90b_flex.diagnose.modal_files import speaks_of_frequency
from rx90b_flex.fleet.make import MakeParameter, RobotValue, parameters, sought
from rx90b_flex.fleet.robots import REFUSED, Outcome, Task, close_robot, fit_again
from rx90b_flex.fleet.second_fit import SecondFit
from rx90b_flex.interrupts import calm
from rx90b_flex.showing import Showing
from rx90b_flex.signals.folders import CLOSED_LOOP, FLEET, check_folder, claim, claimed, files_read, refuse_reading

PLAN_FILE = "plan.json"
ROBOTS = "robots"  # what a folder's plan is of
ANSWERS_S = 20.0  # within which a scheduler answers

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False, repr=False)
class Fleet(Showing):
    """Robots of one make; the content of ``fleet.json`` as attributes, and a sequence of its `robots`.

    Attributes
    ----------
    robots : tuple of Outcome
        What closing the loop on each came to, in the order of the campaigns.
    parameters : tuple of MakeParameter
        Over the robots whose loop was closed: effects that are declared, effects that were found, links.
    folder : Path or None
        Where each robot's results are; None where nothing was to be kept.
    """

    robots: tuple[Outcome, ...]
    parameters: tuple[MakeParameter, ...]
    folder: Path | None

    def __len__(self) -> int:
        return len(self.robots)

    def __getitem__(self, place: int) -> Outcome:
        return self.robots[place]

    def __iter__(self) -> Iterator[Outcome]:
        return iter(self.robots)

    @property
    def compared(self) -> tuple[Outcome, ...]:
        """Robots whose loop was closed."""
        return tuple(o for o in self.robots if o.compared)

    @property
    def not_compared(self) -> tuple[Outcome, ...]:
        """Robots whose campaign was refused, or has a fault."""
        return tuple(o for o in self.robots if not o.compared)

    def standing_out(self, robot: str) -> tuple[tuple[MakeParameter, RobotValue], ...]:
        """By which parameters a robot stands out, the least likely first."""
        own = [(p, v) for p in self.parameters for v in p.values if v.robot == robot and v.stands_out]
        return tuple(sorted(own, key=lambda pair: pair[1].p_value or 0.0))


def close_loop_many(
    campaigns: Sequence[str | os.PathLike[str]],
    *,
    jobs: int = 1,
    dask: str | None = None,
    out: str | os.PathLike[str] | None = None,
    seed: int = 0,
    basics: bool = False,
    despite_faults: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Fleet:
    """Close the loop on campaigns of robots of one make, and say what they have in common and which robot stands out.

    Each loop is closed as by `rx90b_flex.close_loop`. Then every robot is fitted again with the effects that most of them have, and
    asked how much its data hold of every other that was found (`rx90b_flex.fleet.second_fit`). Over the make each parameter has a
    mean with a 95 % interval and a standard deviation between robots; a robot stands out where its value is not one that the
    others predict (`rx90b_flex.fleet.statistics` has the methods and their sources). Results do not depend on the number of workers.

    Parameters
    ----------
    campaigns : sequence of path
        One campaign file a robot.
    jobs : int
        Processes on this machine; with more than one, of a Dask cluster that is started for them.
    dask : str, optional
        Address of a Dask scheduler, in place of `jobs`; its workers see the same files and have this package.
    out : path, optional
        Folder for the results: one a robot, ``fleet.csv``, ``fleet.json`` and ``fleet.html``. Robots that are there already are
        kept, so that a call that was stopped goes on when it is made again. Nothing is kept where it is not given.
    seed, basics, despite_faults
        As in `rx90b_flex.close_loop` and `rx90b_flex.identify`; for all robots.
    overwrite : bool
        Whether a folder of other campaigns is gone on with (what has not changed is kept), and whatever is in the way replaced.
    progress : callable, optional
        Called with a message and a fraction.

    Returns
    -------
    Fleet

    Raises
    ------
    ValueError
        One line: no campaign can be used, the folder cannot be written or holds other robots, or no scheduler answers. A campaign
        that cannot be used beside others that can has the verdict ``refused`` and a reason.

    Examples
    --------
    >>> import rx90b_flex as rf
    >>> results = rf.close_loop_many(["campaign.toml"], out="fleet")
    >>> [robot.verdict for robot in results]
    ['explained']
    >>> results.parameters[0].place
    'shoulder'
    """
    from rx90b_flex.early import check_jobs

    check_jobs(jobs)
    if isinstance(campaigns, str | os.PathLike):
        campaigns = [campaigns]  # not its letters
    options = LoopOptions(seed, basics, despite_faults, jobs=1)
    tell = progress or (lambda _text, _part: None)
    if out is None:
        with tempfile.TemporaryDirectory() as folder:
            tasks = _tasks(campaigns, Path(folder), options)
            return dataclasses.replace(_run(tasks, jobs, dask, tell), folder=None)
    place = Path(os.path.abspath(out))
    check_folder(place, FLEET, overwrite, [Path(c) for c in campaigns])
    tasks = _tasks(campaigns, place, options)
    every = [file for task in tasks for file in files_read(task.campaign)]
    for task in tasks:
        refuse_reading(task.folder, CLOSED_LOOP, every)
    new = not (place / PLAN_FILE).exists()
    _claim(tasks, place, overwrite)
    try:
        fleet = _run(tasks, jobs, dask, tell)
    except ValueError:
        if new and not any(task.done for task in tasks):
            _give_up(place)
        raise
    from rx90b_flex.fleet.output import write_fleet

    tell("writing the table and the page", 1.0)
    write_fleet(fleet, place, overwrite)
    return fleet


def _give_up(place: Path) -> None:
    """Leave nothing of a fleet of which nothing was done."""
    with suppress(OSError):
        (place / PLAN_FILE).unlink()
        place.rmdir()


def _tasks(campaigns: Sequence[str | os.PathLike[str]], folder: Path, options: LoopOptions) -> tuple[Task, ...]:
    paths = [Path(os.path.abspath(c)) for c in campaigns]
    if not paths:
        raise ValueError("no campaign is given; expected one a robot")
    files = [os.path.realpath(p) for p in paths]  # a link is no other robot
    for path, file in zip(paths, files, strict=True):
        if files.count(file) > 1:
            also = next((f" (also as {p})" for p, f in zip(paths, files, strict=True) if f == file and p != path), "")
            raise ValueError(f"{path}: is given {files.count(file)} times{also}; expected one campaign a robot")
    return tuple(Task(n, p, folder / n, options) for n, p in zip(robot_names(paths), paths, strict=True))


def robot_names(paths: Sequence[Path]) -> tuple[str, ...]:
    """A name a campaign, for its folder: the file's, where those differ, else with as many folders before it as it takes.

    A file name that all have in common, such as ``campaign.toml``, is left out.
    """
    stems = [p.stem for p in paths]
    alike = len(paths) > 1 and len(set(stems)) == 1
    for depth in range(max(len(p.parts) for p in paths)):
        names = ["_".join((*p.parts[-1 - depth : -1], *([] if alike and depth else [p.stem]))) for p in paths]
        if len(set(names)) == len(names):
            break
    taken = {PLAN_FILE, FLEET.mark, *FLEET.names}
    return tuple(f"robot_{n}" if n in taken or n.startswith(".") else n for n in names)


def _claim(tasks: Sequence[Task], place: Path, overwrite: bool) -> None:
    """Make the folder this fleet's, or refuse it; of robots that have changed nothing is left."""
    digests = {task.name: task.digest for task in tasks}
    found = claimed(place, PLAN_FILE, ROBOTS)
    if found == digests:
        return
    if not overwrite:
        if found is not None:
            raise ValueError(
                f"{place}: holds other campaigns, or what they were before ({PLAN_FILE}); give another folder, or --overwrite, which "
                "keeps the robots that have not changed"
            )
        for task in tasks:
            if os.path.lexists(task.folder):
                raise ValueError(
                    f"{place}: has {task.name} already, but no {PLAN_FILE}; give another folder, or --overwrite"
                )
    known = found if isinstance(found, dict) else {}
    for task in tasks:
        if known.get(task.name) != digests[task.name] and task.folder.is_dir():
            for name in sorted(CLOSED_LOOP.own(task.folder), key=lambda n: n != CLOSED_LOOP.mark):
                (task.folder / name).unlink()
    claim(place, PLAN_FILE, digests, {"campaigns": {task.name: str(task.campaign) for task in tasks}})


# ---- running ----------------------------------------------------------------------------------------------------


Call = tuple[Callable[..., Any], tuple[Any, ...]]


def _run(tasks: Sequence[Task], jobs: int, dask: str | None, tell: Progress) -> Fleet:
    resumed = sum(task.done for task in tasks)
    tell(f"{resumed} of {len(tasks)} robots", 0.0)
    with _workers(min(jobs, len(tasks)), dask) as each:
        outcomes = _closed(tasks, each, tell)
        used = [o for o in outcomes if o.verdict != REFUSED]
        if not used:
            more = f" (and {len(outcomes) - 1} more campaigns)" if len(outcomes) > 1 else ""
            raise ValueError(f"{outcomes[0].reason}{more}")
        fits = _fitted_again(tasks, outcomes, each, tell)
    why_not = {name: fit for name, fit in fits.items() if isinstance(fit, str)}
    told = (dataclasses.replace(o, reason=why_not.get(o.name, o.reason)) for o in outcomes)
    compared = {name: fit for name, fit in fits.items() if isinstance(fit, SecondFit)}
    return Fleet(tuple(told), parameters(compared), tasks[0].folder.parent)


def _fitted_again(
    tasks: Sequence[Task], outcomes: Sequence[Outcome], each: _Each, tell: Progress
) -> dict[str, SecondFit | str]:
    """The second fits of all robots that can be compared, or why there is none."""
    common, others = sought(outcomes)
    compared = [(t, o) for t, o in zip(tasks, outcomes, strict=True) if o.compared]
    calls: list[Call] = [(fit_again, (t, o.found, common, others, len(compared))) for t, o in compared]
    total = len(calls)
    fits = dict(each(calls, lambda done: tell(f"comparing, {done} of {total} robots", 0.9 + 0.1 * done / total)))
    return {o.name: str(fits[i]) if isinstance(fits[i], Exception) else fits[i] for i, (_, o) in enumerate(compared)}


def _closed(tasks: Sequence[Task], each: _Each, tell: Progress) -> tuple[Outcome, ...]:
    outcomes: dict[int, Outcome] = {}
    calls: list[Call] = [(_frequency, (t,)) if speaks_of_frequency(t.campaign) else (close_robot, (t,)) for t in tasks]
    for i, outcome in each(calls, lambda done: tell(f"{done} of {len(tasks)} robots", 0.9 * done / len(tasks))):
        if isinstance(outcome, _WorkersDied):
            outcome = Outcome.refused(tasks[i], f"{tasks[i].campaign}: {outcome}")
        if isinstance(outcome, Exception):
            raise outcome
        outcomes[i] = outcome
    return tuple(outcomes[i] for i in range(len(tasks)))


def _frequency(task: Task) -> Outcome:
    return Outcome.refused(task, f"{task.campaign}: speaks of frequencies; expected a campaign of torques over time")


class _WorkersDied(Exception):
    """So many workers died of one robot that it is given up."""


_Each = Callable[[Sequence[Call], Callable[[int], None]], Iterator[tuple[int, Any]]]


@contextmanager
def _workers(jobs: int, address: str | None) -> Iterator[_Each]:
    """What calls functions and yields (number, result or exception) as they are done: here, or Dask's workers."""
    if jobs == 1 and address is None:
        yield _here
        return
    from distributed import Client, LocalCluster

    if address is not None:
        try:
            client = Client(address, timeout=ANSWERS_S)
        except (OSError, ValueError, TypeError) as error:
            said = " ".join(str(error).split())[:200]
            raise ValueError(f"dask is {address!r}: no scheduler answers: {said}") from None
        with client:
            yield lambda calls, tell: _by_dask(client, calls, tell)
        return
    # a loop is one process's work; how much memory it takes is for the machine to say
    with (
        LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            memory_limit=0,
            dashboard_address=None,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # or it says that another one has its port
            silence_logs="CRITICAL",
        ) as cluster,
        Client(cluster) as client,
    ):
        try:
            yield lambda calls, tell: _by_dask(client, calls, tell)
        except KeyboardInterrupt:
            calm()  # the cluster takes a moment to end
            raise


def _here(calls: Sequence[Call], tell: Callable[[int], None]) -> Iterator[tuple[int, Any]]:
    for i, (function, arguments) in enumerate(calls):
        result = function(*arguments)
        tell(i + 1)
        yield i, result


def _by_dask(client: Any, calls: Sequence[Call], tell: Callable[[int], None]) -> Iterator[tuple[int, Any]]:
    """Its scheduler gives a call whose worker died to another worker, `distributed.scheduler.allowed-failures` times."""
    from distributed import KilledWorker, as_completed

    futures = {client.submit(function, *arguments, pure=False): i for i, (function, arguments) in enumerate(calls)}
    # with results: those that a worker kept to itself would have to be worked out again where it dies
    ended = as_completed(futures, with_results=True, raise_errors=False)
    for done, (future, result) in enumerate(ended, start=1):
        tell(done)
        error = result[1] if future.status == "error" else None
        if isinstance(error, KilledWorker):
            error = _WorkersDied("the processes that worked on it died again and again; too little memory?")
        yield futures[future], result if error is None else error
        future.release()
