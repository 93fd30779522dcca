"""Settings of every test: the same examples each time, no window, no fight for the cores."""

from __future__ import annotations

import os

from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "Agg")
if "PYTEST_XDIST_WORKER" in os.environ:  # one worker a core already; here, before NumPy starts its threads
    os.environ.setdefault("OMP_NUM_THREADS", "1")

# Examples follow from the test's text, not from chance or the clock. More: pytest --hypothesis-profile=default
settings.register_profile("deterministic", derandomize=True, deadline=None, database=None, print_blob=True)
settings.load_profile("deterministic")
