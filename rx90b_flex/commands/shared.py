"""What commands share: options, a progress bar, lines and tables on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option


def _folder(text: str) -> Path:
    """Of ``--out``; an empty one, as an unset variable of a shell leaves it, is no folder."""
    if not text:
        raise typer.BadParameter("is empty; expected a folder")
    return Path(text)


def _out(help: str) -> Any:
    return Option("--out", parser=_folder, metavar="PATH", help=f"Folder for the {help}")


Out = Annotated[Path, _out("results; made if it does not exist, an earlier result in it is replaced.")]
CampaignOut = Annotated[
    Path, _out("campaign; made if it does not exist. A campaign in it is replaced with --overwrite only.")
]
ROBOT_HELP = "Robot name, robot file, URDF, or example-robot-data:NAME."
RobotSource = Annotated[str, Argument(help=ROBOT_HELP)]
CampaignFile = Annotated[Path, Argument(help="Campaign file (TOML).")]
LowHz = Annotated[float, Option(help="Lowest line.")]
HighHz = Annotated[float, Option(help="Highest line.")]
Overwrite = Annotated[
    bool, Option("--overwrite", help="Replace files and folders in the way of the results, whoever wrote them.")
]
Despite = Annotated[bool, Option("--despite-faults", help="Go on where the data were found not usable.")]
Basics = Annotated[
    bool, Option("--basics", help="Declare drive inertia, dry and viscous friction and an offset on every joint.")
]


@contextmanager
def progress() -> Iterator[Callable[[str, float], None]]:
    """A progress bar on standard error, with the present step as its text."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    bar = Progress(
        TextColumn("{task.description:<36}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,  # in a pipe it would leave an empty line
    )
    with bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda text, part: bar.update(task, description=text, completed=part)


def say(text: str) -> None:
    """A line on standard output, as it is: names may hold what rich takes for markup or an emoji."""
    from rich.console import Console
    from rich.text import Text

    Console().print(Text(text), soft_wrap=True)


def fitted_into(
    out: Path,
    results: Any,
    overwrite: bool,
    fit: Callable[[], Any],
    write: Callable[[Any, Path], None],
    report: Callable[[Any, Path], None],
    headline: Callable[[Any], Sequence[str]],
) -> None:
    """Fit, fill the folder with what `write` and `report` make of it, and say the headline. `results` names the folder's files."""
    from rx90b_flex.signals.folders import fill_folder

    with progress() as tell:
        tell("reading", 0.1)
        result = fit()

        def fill(folder: Path) -> None:
            write(result, folder)
            report(result, folder / "report.html")

        fill_folder(out, fill, results, overwrite)
    for line in headline(result):
        say(line)
    say(f"Report: {out / 'report.html'}")


def show_table(title: str, rows: Sequence[Sequence[str]], head: Sequence[str], right: Sequence[str] = ()) -> None:
    """A table on standard output; columns of the names in `right` stand to the right."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left")
    for i, name in enumerate(head):
        whole = all(" " not in row[i] for row in rows)  # names and numbers stay whole as long as sentences can give way
        table.add_column(Text(name), justify="right" if name in right else "left", overflow="fold", no_wrap=whole)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    Console().print(table)


def without_types_of_flags(options: list[Any]) -> list[Any]:
    """Options whose flags say no type in the help: there is nothing to write after them."""
    for option in options:
        if getattr(option, "is_flag", False):
            option.metavar = ""
    return options


def numbers(name: str, text: str) -> tuple[float, ...]:
    """Of an option that takes several."""
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{name} is {text!r}; expected numbers with commas between them") from None


def value_words(name: str, value: float, std: float | None, unit: str) -> str:
    """A parameter with its standard deviation."""
    return f"{name} {value:.4g} ± {std:.2g} {unit}" if unit != "-" else f"{name} {value:.4g} ± {std:.2g}"
