"""One HTML file that opens offline: sections of text, tables and figures, in the style of every report."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import jinja2
import markupsafe
import matplotlib
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from rx90b_flex import __version__
from rx90b_flex.signals.tables import write_whole
from rx90b_flex.view.zoom import ZOOM_COLUMNS, described, script, script_hash, thin, zoom_style


@dataclass(frozen=True)
class Image:
    """A figure as it stands in the page."""

    source: str
    alt: str
    width: int
    height: int
    caption: str = ""
    zoom: str = ""  # Markup: what it shows as JSON, where it zooms in a browser


@dataclass(frozen=True)
class PageTable:
    """Rows under a head; columns of numbers stand to the right.

    Attributes
    ----------
    head : one text a column, with its unit.
    rows : one text a column each.
    caption : what the table shows.
    numbers : columns that hold numbers; all but the first where not given.
    folds : whether a long one waits to be opened.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    numbers: Sequence[int] | None = None
    folds: bool = True

    def is_number(self, column: int) -> bool:
        """Whether a column stands to the right."""
        return column in (range(1, len(self.head)) if self.numbers is None else self.numbers)


def seconds_table(seconds: Mapping[str, float]) -> PageTable:
    """How long each stage took."""
    return PageTable(("stage", "time, s"), [(stage, f"{s:.1f}") for stage, s in seconds.items()])


class Section:
    """A part of a page: paragraphs, then tables, figures and smaller parts, in whatever order they are given; None is nothing."""

    def __init__(self, title: str, *content: str | PageTable | Image | Section | None) -> None:
        self.title = title
        self.text = [x for x in content if isinstance(x, str)]
        self.tables = [x for x in content if isinstance(x, PageTable)]
        self.images = [x for x in content if isinstance(x, Image)]
        self.parts = [x for x in content if isinstance(x, Section)]


def write_page(path: Path, title: str, lead: Sequence[str], sections: Sequence[Section | None]) -> None:
    """Write a page; it appears whole or not at all.

    Parameters
    ----------
    path : Path
        The file; its folder exists.
    title : str
    lead : sequence of str
        The main result in a sentence, then what qualifies it.
    sections : sequence of Section or None
        None is left out.
    """
    shown = [section for section in sections if section is not None]
    zooms = any(image.zoom for section in shown for image in section.images)
    html = render("page.html", title=title, lead=lead, sections=shown, zooms=zooms, source="")
    write_whole(Path(path), lambda temporary: temporary.write_text(html, encoding="utf-8"))


def render(name: str, filters: Mapping[str, object] | None = None, **values: object) -> str:
    """A page from a template that is or extends ``page.html``, with filters and values of its own."""
    own = resources.files("rx90b_flex.view").joinpath("style.css").read_text(encoding="utf-8")
    common = {"version": __version__, "script": script(), "script_hash": script_hash()}
    return template(name, **(filters or {})).render(style=markupsafe.Markup(own) + zoom_style(), **common, **values)


@cache
def template(name: str, **filters: object) -> jinja2.Template:
    """A template of this folder, with filters added; compiled once."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rx90b_flex.view", ""),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update(filters)
    return environment.get_template(name)


def image(figure: Figure, alt: str, caption: str = "", zoom: bool = False) -> Image:
    """A figure as SVG in a data URI: sharp on paper, and its ids cannot clash with those of other figures.

    Long lines are thinned for it. With `zoom` the page holds them finer, too, and a browser draws them so that one can zoom in.

    Raises
    ------
    ValueError
        A figure that shall zoom and holds more than lines, bands and spans.
    """
    said = ""
    if zoom:
        thin(figure, ZOOM_COLUMNS)
        said = described(figure)
    thin(figure)
    buffer = io.BytesIO()
    # the salt makes ids, and so the whole report, the same for the same result
    with matplotlib.rc_context({"svg.hashsalt": "rx90b_flex", "svg.fonttype": "path"}), _laid_out(figure):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    source = "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
    width, height = (round(96 * x) for x in figure.get_size_inches())
    return Image(source, alt, width, height, caption, said)


@contextmanager
def _laid_out(figure: Figure) -> Iterator[None]:
    """Axes in their places for SVG, so that saving need not draw all of a figure twice, the first time for its layout alone."""
    engine, dpi, canvas = figure.get_layout_engine(), figure.dpi, figure.canvas
    if engine is None:
        yield
        return
    FigureCanvasSVG(figure)
    figure.dpi = 72  # SVG's
    engine.execute(figure)
    figure.set_layout_engine("none")
    figure.dpi = dpi
    try:
        yield
    finally:
        figure.set_layout_engine(engine)
        figure.set_canvas(canvas)
