"""Claims about figures that zoom: what the page holds is what the figure shows, and what it cannot hold is refused."""

from __future__ import annotations

import base64
import hashlib
import json
from importlib import resources

import numpy as np
import pytest
from matplotlib.figure import Figure

from rx90b_flex.view.page import image
from rx90b_flex.view.zoom import ZOOM_COLUMNS, described, script, script_hash


def unpacked(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype="<f4")


def test_lines_bands_spans_and_levels_come_back_as_they_were_drawn() -> None:
    figure = Figure()
    top, bottom = figure.subplots(2, 1, sharex=True)
    x = np.linspace(0.0, 3.0, 50)
    top.plot(x, np.sin(x), color="#0072b2", label="sine <b>")
    top.fill_between(x, np.sin(x) - 0.1, np.sin(x) + 0.2, color="#d55e00", alpha=0.25, label="band")
    top.axhline(0.5, linestyle="--")
    top.axvspan(1.0, 2.0, alpha=0.2)
    bottom.semilogy(x, np.exp(x), ".", label="dots")
    bottom.set_xlabel("time, s")
    text = described(figure)
    assert "<" not in text
    said = json.loads(text)
    first, second = said["axes"]
    (line,), (band,), (level,), (span,) = (first[name] for name in ("series", "bands", "levels", "spans"))
    np.testing.assert_allclose(unpacked(line["x"]), x, rtol=1e-6)
    np.testing.assert_allclose(unpacked(line["y"]), np.sin(x), atol=1e-6)
    np.testing.assert_allclose(unpacked(band["high"]) - unpacked(band["low"]), 0.3, atol=1e-6)
    assert (level["y"], span["from"], span["to"], line["label"]) == (0.5, 1.0, 2.0, "sine <b>")
    assert second["ylog"] and not second["series"][0]["line"] and second["series"][0]["marks"] > 0
    assert said["sharex"] and said["xlabel"] == "time, s"
    assert first["xlim"] == pytest.approx(top.get_xlim()) and second["ylim"] == pytest.approx(bottom.get_ylim())


def test_bars_and_lines_that_turn_back_are_refused() -> None:
    bars = Figure()
    bars.subplots().barh([0, 1], [1.0, 2.0])
    with pytest.raises(ValueError, match="no bars"):
        described(bars)
    loop = Figure()
    loop.subplots().plot([0.0, 1.0, 0.5], [0.0, 1.0, 2.0])
    with pytest.raises(ValueError, match="goes back over x"):
        described(loop)


def test_a_long_line_is_held_finer_for_zooming_than_for_paper_and_keeps_its_peaks() -> None:
    figure = Figure()
    ax = figure.subplots()
    y = np.sin(np.arange(100_000.0) / 5000)
    y[45_678] = 50.0
    (line,) = ax.plot(np.arange(100_000.0), y)
    held = unpacked(json.loads(image(figure, "sine", zoom=True).zoom)["axes"][0]["series"][0]["y"])
    assert len(line.get_xdata()) < len(held) <= 2 * ZOOM_COLUMNS + 2  # type: ignore[arg-type]
    assert held.max() == 50.0 and np.asarray(line.get_ydata()).max() == 50.0


def test_the_library_is_whole_and_has_its_licence_beside_it() -> None:
    folder = resources.files("rx90b_flex.view").joinpath("vendor")
    notice, licence = (folder.joinpath(name).read_text() for name in ("NOTICE", "LICENSE"))
    library = folder.joinpath("uPlot.iife.min.js").read_text()
    version = library.split("(v")[1].split(")")[0]
    assert f"uPlot {version}" in notice and "MIT License" in licence
    digest = base64.b64encode(hashlib.sha256(script().encode()).digest()).decode()
    assert script_hash() == f"'sha256-{digest}'"
    assert len(script()) < 64_000  # what the documentation says that it costs
