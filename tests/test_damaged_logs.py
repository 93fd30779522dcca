"""Logs that were cut short or altered: whatever the reader of the format makes of it, one line that names the file, or data."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from test_importers import bag, german, matlab, matlab_73, mcap_file, parquet, zipped

from rx90b_flex.signals import matlab as matlab_reader
from rx90b_flex.signals.logs import read_log
from rx90b_flex.signals.tables import number_of, read_table

WRITERS = [matlab, matlab_73, parquet, zipped, german, bag, mcap_file]


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Cut, with twenty bytes altered (at the beginning or anywhere), or with some left out."""
    if rng.integers(4) == 0:
        return content[: rng.integers(1, len(content))]
    out = bytearray(content)
    if rng.integers(3) == 0:
        at = int(rng.integers(len(out)))
        del out[at : at + int(rng.integers(1, 200))]
        return bytes(out)
    reach = len(out) if rng.integers(2) else min(len(out), 400)
    for at in rng.integers(0, reach, 20):
        out[at] = rng.integers(256)
    return bytes(out)


@pytest.mark.parametrize("count", [8, pytest.param(24, marks=pytest.mark.slow)])
@pytest.mark.parametrize("write", WRITERS)
def test_a_damaged_log_is_read_or_refused_by_name(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], write: Callable[[Path], Path], count: int
) -> None:
    if write in (bag, mcap_file):
        pytest.importorskip("rosbags")
    path = write(tmp_path)
    files = sorted(p for p in path.iterdir()) if path.is_dir() else [path]
    rng = np.random.default_rng(len(path.name))
    for _ in range(count):
        file = files[rng.integers(len(files))]
        content = file.read_bytes()
        file.write_bytes(damaged(content, rng))
        try:
            assert len(read_log(path).values) > 1
        except ValueError as error:
            assert str(error).startswith(str(path)) and "\n" not in str(error)
        file.write_bytes(content)
    assert capfd.readouterr() == ("", "")


def test_a_reader_that_crashes_takes_nobody_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, script = matlab(tmp_path), tmp_path / "crashes.py"
    script.write_text(f"import os\nos.kill(os.getpid(), {int(signal.SIGSEGV)})\n")
    monkeypatch.setattr(matlab_reader, "__file__", str(script))
    with pytest.raises(ValueError, match=r"run\.mat: cannot be read: its reader crashed"):
        read_log(path)
    assert os.getpid()


@pytest.mark.parametrize("cell", ["1_000", "١", "٣.٥", "1e", "１", "1e+", "1 000", "--1"])
def test_a_cell_that_no_other_program_takes_for_a_number_is_none(tmp_path: Path, cell: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time,q1,tau1\n0,1,2\n" + f"0.1,{cell},3\n", encoding="utf-8")
    for read in (lambda: read_log(path), lambda: read_table(path, ["q1"])):
        with pytest.raises(ValueError, match=r"run\.csv: column 'q1', row 2: .* is not a number"):
            read()


@pytest.mark.parametrize("cell", ["1", "-1.5", "+2.", ".5", "1e3", "1E-3", " 7 ", "nan", "-inf", "Infinity", "1e999"])
def test_a_cell_that_every_program_takes_for_a_number_is_one(cell: str) -> None:
    assert number_of(cell) == float(cell) or (np.isnan(float(cell)) and np.isnan(number_of(cell) or 0.0))
