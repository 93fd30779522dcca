"""Settings of every test: the same examples each time, no window, no fight for the cores."""

from __future__ import annotations

import gc
import os

import pytest
from hypothesis import settings
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling

os.environ.setdefault("MPLBACKEND", "Agg")
if "PYTEST_XDIST_WORKER" in os.environ:  # one worker a core already; here, before NumPy starts its threads
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    gc.disable()  # until all tests are imported: nothing of that goes away again, and to look through it takes a third of the time

# Examples follow from the test's text, not from chance or the clock. More: pytest --hypothesis-profile=default
settings.register_profile("deterministic", derandomize=True, deadline=None, database=None, print_blob=True)
settings.load_profile("deterministic")


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


class ByValues(LoadScopeScheduling):
    """Tests of a group, or of a file with the same parameters, to one worker: what a fixture makes for them is made once."""

    def _split_scope(self, nodeid: str) -> str:
        _, marked, group = nodeid.rpartition("@")
        if marked and "]" not in group:
            return group
        file, _, test = nodeid.partition("::")
        return f"{file}[{test.partition('[')[2]}"


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> LoadScopeScheduling | None:
    return ByValues(config, log) if config.getvalue("dist") == "loadgroup" else None
