"""Figures that zoom in a browser: what a figure of lines shows, as JSON for uPlot, and the script that draws it.

The static picture stays in the page: paper shows it, and so does a reader that runs no script.
"""

from __future__ import annotations

import base64
import hashlib
import json
from functools import cache
from importlib import resources
from itertools import pairwise
from typing import Any

import markupsafe
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import Collection, PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator

from rx90b_flex.effects.motion import Array

DRAWN_COLUMNS = 600  # columns of a line's envelope on paper: two points each, about one a pixel
ZOOM_COLUMNS = 2000  # the same where one can zoom in
PX_PER_POINT = 96 / 72
DASHES = {"-": [], "--": [5, 3], ":": [2, 2], "-.": [6, 2, 2, 2]}


def envelope(x: Array, y: Array, columns: int = DRAWN_COLUMNS) -> tuple[Array, Array]:
    """Thin a line for drawing: of each column the smallest and the largest sample, in their order. Peaks stay."""
    if len(x) <= 2 * columns:
        return x, y
    edges = np.linspace(0, len(x), columns + 1).astype(int)
    kept = [a + i for a, b in pairwise(edges) for i in {y[a:b].argmin(), y[a:b].argmax()}]
    places = np.unique([0, *kept, len(x) - 1])
    return x[places], y[places]


def thin(figure: Figure, columns: int = DRAWN_COLUMNS) -> None:
    """Thin every long line of a figure to an envelope of at most so many columns over the width of its axes."""
    for ax in figure.axes:
        low, high = ax.get_xlim()
        for line in _lines(ax):
            x, y = (np.asarray(values, dtype=float) for values in line.get_data())
            if len(x) > 2 and np.all(np.diff(x) > 0) and np.isfinite(y).all():
                own = max(2, round(columns * min(1.0, (x[-1] - x[0]) / (high - low))))
                line.set_data(*envelope(x, y, own))


def described(figure: Figure) -> markupsafe.Markup:
    """What a drawn figure shows, as JSON that may stand in a script element.

    Parameters
    ----------
    figure : Figure
        Lines over ascending x, bands between two of them, spans and levels; its limits are final.

    Raises
    ------
    ValueError
        Something else is in it.
    """
    axes = [ax for ax in figure.axes if ax.axison]
    places = [ax.get_subplotspec() for ax in axes]
    if any(place is None for place in places):
        raise ValueError("a figure that zooms has its axes in one grid")
    grids = {id(place.get_gridspec()): place.get_gridspec() for place in places if place is not None}
    (grid,) = grids.values()
    said = [_axes(ax, figure) for ax in axes]
    named = {x["label"]: x for one in said for x in (*one["series"], *one["levels"], *one["bands"], *one["spans"])}
    shown = {
        text.get_text() for ax in axes for legend in (ax.get_legend(), *figure.legends) if legend for text in legend.texts
    }  # fmt: skip
    legend = [
        {"label": label, "colour": x["colour"], "dash": x.get("dash", []), "line": x.get("line", True),
         "alpha": x.get("alpha", 1.0), "band": "alpha" in x}
        for label, x in named.items() if label and (not shown or label in shown)
    ]  # fmt: skip
    whole: dict[str, Any] = {"xlabel": "", "ylabel": ""}
    for name in whole:
        labels = {one[name] for one in said} - {""}
        if len(labels) == 1 and (name == "xlabel" or len(said) > 1):
            whole[name] = labels.pop()
            for one in said:
                one[name] = ""
    for one in said:  # the axis's label stands above it, where it needs no turning and has room
        one["title"] = ": ".join(text for text in (one["title"], one.pop("ylabel")) if text)
    shared = axes[0].get_shared_x_axes()
    whole |= {"columns": grid.ncols, "sharex": all(shared.joined(axes[0], ax) for ax in axes[1:])}
    text = json.dumps(whole | {"legend": legend, "axes": said}, separators=(",", ":"))
    return markupsafe.Markup(text.replace("<", "\\u003c").replace("&", "\\u0026"))


@cache
def script() -> markupsafe.Markup:
    """The code that draws all figures of a page that are not drawn yet: uPlot and ours, in a scope of their own."""
    code = f"(() => {{\n{_text('vendor/uPlot.iife.min.js')}\n{_text('zoom.js')}}})();"
    if "</script" in code or "<!--" in code:
        raise ValueError("a script in a page cannot hold its own end")
    return markupsafe.Markup(code)


@cache
def script_hash() -> str:
    """The script's hash as a content security policy names it, so that a page runs nothing else."""
    return "'sha256-" + base64.b64encode(hashlib.sha256(script().encode()).digest()).decode("ascii") + "'"


@cache
def zoom_style() -> markupsafe.Markup:
    """Style sheet of figures that zoom."""
    return markupsafe.Markup(_text("vendor/uPlot.min.css") + "\n" + _text("zoom.css"))


def _text(name: str) -> str:
    return resources.files("rx90b_flex.view").joinpath(name).read_text(encoding="utf-8")


def _lines(ax: Axes) -> list[Line2D]:
    """Those whose both coordinates are data."""
    return [line for line in ax.lines if line.get_transform() == ax.transData]


def _axes(ax: Axes, figure: Figure) -> dict[str, Any]:
    place = ax.get_subplotspec()
    assert place is not None
    ratios = np.asarray(place.get_gridspec().get_height_ratios(), dtype=float)
    width, height = figure.get_size_inches()
    title = " ".join(filter(None, (ax.get_title(), ax.get_title("left"))))
    notes = [text.get_text() for text in ax.texts if text.get_text()]
    spans = [_span(ax, patch) for patch in ax.patches]
    bands: list[dict[str, Any]] = []
    for collection in ax.collections:
        in_data = collection.get_offset_transform() is not None and collection.get_transform() == ax.transData
        (bands if in_data else spans).extend(_filled(collection, in_data))
    series, levels = [], []
    for line in ax.lines:
        style: dict[str, Any] = {
            "label": _label(line), "colour": to_hex(line.get_color()), "width": round(line.get_linewidth() * PX_PER_POINT, 2),
            "dash": DASHES.get(str(line.get_linestyle()), []),
        }  # fmt: skip
        x, y = (np.asarray(values, dtype=float) for values in line.get_data())
        if line.get_transform() == ax.transData:
            if np.any(np.diff(x) < 0):
                raise ValueError(f"line {line.get_label()!r} goes back over x")
            marks = 0.0 if line.get_marker() in ("None", "", None) else round(line.get_markersize() * PX_PER_POINT, 1)
            # a comma is matplotlib's pixel and a point is drawn at half its size
            marks = max(2.0, 0.6 * marks) if line.get_marker() == "." else marks
            steps = line.get_drawstyle() == "steps-post"
            drawn = line.get_linestyle() != "None"
            series.append(style | {"steps": steps, "line": drawn, "marks": marks, "x": _packed(x), "y": _packed(y)})
        elif line.get_transform() == ax.get_yaxis_transform(which="grid"):
            levels.append(style | {"y": float(y[0])})
        else:
            spans.append({"label": "", "colour": style["colour"], "alpha": 1.0, "from": float(x[0]), "to": float(x[0])})
    return {
        "row": place.rowspan.start, "column": place.colspan.start,
        # over the figure's width
        "height": round(float(height / width * ratios[place.rowspan.start] / ratios.sum()), 4),
        "title": _plain(", ".join([title, *notes] if title else notes)), "xlabel": _plain(ax.get_xlabel()),
        "ylabel": _plain(ax.get_ylabel()), "xlim": _limits(ax.get_xlim()), "ylim": _limits(ax.get_ylim()),
        "xlog": ax.get_xscale() == "log", "ylog": ax.get_yscale() == "log",
        "xticks": _ticks(ax.xaxis.get_major_locator()), "yticks": _ticks(ax.yaxis.get_major_locator()),
        "series": series, "levels": levels, "bands": bands, "spans": spans,
    }  # fmt: skip


def _span(ax: Axes, patch: Any) -> dict[str, Any]:
    if not isinstance(patch, Rectangle):
        raise ValueError(f"a figure that zooms has no {type(patch).__name__}")
    said = {"label": _label(patch), "colour": to_hex(patch.get_facecolor()), "alpha": float(patch.get_alpha() or 1.0)}
    box = patch.get_bbox()
    if patch.get_data_transform() == ax.get_xaxis_transform(which="grid"):
        return said | {"from": float(box.xmin), "to": float(box.xmax)}
    if patch.get_data_transform() == ax.get_yaxis_transform(which="grid"):
        return said | {"bottom": float(box.ymin), "top": float(box.ymax)}
    raise ValueError("a figure that zooms has no bars")


def _filled(collection: Collection, in_data: bool) -> list[dict[str, Any]]:
    """Bands of a fill between two lines; where one coordinate is a part of the axes, spans of x."""
    if not isinstance(collection, PolyCollection):
        raise ValueError(f"a figure that zooms has no {type(collection).__name__}")
    (colour,) = collection.get_facecolor()  # type: ignore[misc]
    said = {"label": _label(collection), "colour": to_hex(colour), "alpha": float(collection.get_alpha() or 1.0)}
    out = []
    for path in collection.get_paths():
        points = np.asarray(path.vertices)
        if not in_data:
            out.append(said | {"from": float(points[:, 0].min()), "to": float(points[:, 0].max())})
            continue
        # matplotlib goes along the first line, back along the second, and repeats its ends
        count = (len(points) - 3) // 2
        there, back = points[1 : count + 1], points[count + 2 : 2 * count + 2][::-1]
        if len(points) != 2 * count + 3 or not np.array_equal(there[:, 0], back[:, 0]):
            raise ValueError("a filled area that is not between two lines over the same x")
        out.append(said | {"x": _packed(there[:, 0]), "low": _packed(there[:, 1]), "high": _packed(back[:, 1])})
    return out


def _label(artist: Any) -> str:
    label = str(artist.get_label())
    return "" if label.startswith("_") else _plain(label)


def _plain(text: str) -> str:
    """In one line, and with dollars that were kept from being mathematics."""
    return " ".join(text.replace(r"\$", "$").split())


def _limits(limits: tuple[float, float]) -> list[float]:
    return [float(x) for x in limits]


def _ticks(locator: Any) -> list[float] | None:
    return [float(x) for x in locator()] if isinstance(locator, FixedLocator) else None


def _packed(values: Array) -> str:
    """Numbers as base64 of little-endian 32-bit floats."""
    return base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii")
