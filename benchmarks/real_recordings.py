"""Close the loop on real recordings: error before, after, and of a free-form model that says what can be explained at all.

    python benchmarks/real_recordings.py                        # every campaign of the data folder; prints the table
    python benchmarks/real_recordings.py --readme --jobs 2      # and writes README's table and figure
    python benchmarks/real_recordings.py --only tx40 emps --out results

The data folder holds one folder a campaign, with `campaign.toml`: `$RX90B_FLEX_DATA`, else `shared/data` beside the repository.
Errors are relative, on the validation recordings, which nothing was fitted to. Times: of the processor, one thread a campaign.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import joblib
import numpy as np
from matplotlib.figure import Figure

import rx90b_flex as rf
from rx90b_flex.diagnose.output import write_result
from rx90b_flex.signals.tables import write_whole
from rx90b_flex.view.axes import AFTER, BEFORE, REACHED
from rx90b_flex.view.report import percent, write_report

ROOT = Path(__file__).resolve().parent.parent
PICTURE = ROOT / ".readme" / "real_recordings.png"
BEGIN, END = (
    "<!-- real recordings: written by benchmarks/real_recordings.py --readme -->",
    "<!-- end of real recordings -->",
)
NAMED = 4  # types of effects that a row of the table names


@dataclass(frozen=True)
class Row:
    """One campaign: relative errors on validation, and what was found."""

    name: str
    joints: int
    fitted_s: float
    held_out_s: float
    declared: float
    after: float
    free_form: float | None
    share: float | None
    moving_after: float
    verdict: str
    found: tuple[str, ...]  # types of effects, each with the number of places
    processor_s: float


def data_folder() -> Path:
    """Where the campaigns lie."""
    folder = Path(os.environ.get("RX90B_FLEX_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        raise SystemExit(f"{folder}: no such folder; set RX90B_FLEX_DATA to the one that holds the campaigns")
    return folder


def closed(folder: Path, out: Path | None) -> Row:
    """Close the loop on one campaign; with `out`, write everything that belongs to the result into a folder of its name."""
    start = time.process_time()
    result = rf.close_loop(folder / "campaign.toml")
    seconds = time.process_time() - start
    if result.verdict == "data_fault":
        raise SystemExit(f"{folder}: " + " ".join(f.message for f in result.data_faults))
    if out is not None:
        write_result(result, out / folder.name, extra=[lambda r, at: write_report(r, at / "report.html")])
    known = result.explainable
    return Row(
        folder.name,
        len(result.joints),
        sum(r.duration_s for r in result.campaign.identification),
        sum(r.duration_s for r in result.campaign.validation),
        result.before.validation.relative_error,
        result.after.validation.relative_error,
        None if known is None else known.validation.relative_error,
        None if known is None else known.share,
        result.moving.after,
        result.verdict,
        kinds([e.effect.type_name() for e in result.effects]),
        seconds,
    )


def kinds(names: Sequence[str]) -> tuple[str, ...]:
    """Types of effects in the order in which they were found, with the number of places where there are several."""
    counts = {name: names.count(name) for name in names}
    words = {name: name.replace("_", " ") for name in counts}
    return tuple(f"{words[name]} ({count})" if count > 1 else words[name] for name, count in counts.items())


def table(rows: Sequence[Row]) -> str:
    """The table in Markdown."""
    lines = [
        "| recording | joints | fitted + held out | declared | after | free form | share of the explainable | verdict | found |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        found = ", ".join(r.found[:NAMED]) + (", …" if len(r.found) > NAMED else "")
        lines.append(
            f"| {r.name} | {r.joints} | {r.fitted_s:.0f} + {r.held_out_s:.0f} s | {percent(r.declared, 2)} | "
            f"**{percent(r.after, 2)}** | {'–' if r.free_form is None else percent(r.free_form, 2)} | "
            f"{'–' if r.share is None else f'{100 * r.share:.0f} %'} | {r.verdict.replace('_', ' ')} | {found or '–'} |"
        )
    return "\n".join(lines) + "\n"


def picture(rows: Sequence[Row]) -> Figure:
    """Bars of each campaign: declared, after, free form, as parts of the declared model's error."""
    figure = Figure(figsize=(7.2, 0.9 + 0.62 * len(rows)), layout="constrained")
    ax = figure.subplots()
    y = np.arange(len(rows))
    for shift, colour, hatch, label, values in (
        (-0.27, BEFORE, "////", "declared model", [r.declared for r in rows]),
        (0.0, AFTER, "", "with the effects found", [r.after for r in rows]),
        (0.27, REACHED, "....", "free-form model", [np.nan if r.free_form is None else r.free_form for r in rows]),
    ):
        widths = 100 * np.array(values) / np.array([r.declared for r in rows])
        bars = ax.barh(
            y + shift, np.nan_to_num(widths), 0.25, color=colour, hatch=hatch, edgecolor="white", label=label
        )
        texts = ["not known" if np.isnan(v) else percent(v, 2) for v in values]
        ax.bar_label(bars, texts, padding=3, fontsize=8)
    ax.set_yticks(y, [r.name.replace("_", " ") for r in rows])
    ax.invert_yaxis()
    ax.set_xlim(0, 1.18 * max(100.0, *(100 * r.after / r.declared for r in rows)))
    ax.set_xlabel(
        "torque error on recordings that were not fitted, % of the declared model's\n(labels: % of the torque)",
        fontsize=9,
    )
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(fontsize=8, frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    return figure


def into_readme(text: str, rows: Sequence[Row]) -> str:
    """README with the table between its two marks.

    Raises
    ------
    SystemExit
        A mark is missing.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise SystemExit(f"README.md: expected the lines {BEGIN!r} and {END!r} around the table")
    return f"{before}{BEGIN}\n{table(rows)}{END}{after}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="names of campaign folders")
    parser.add_argument("--out", type=Path, help="folder for the results: reports, robots, predictions")
    parser.add_argument("--readme", action="store_true", help="write README's table and figure")
    parser.add_argument("--jobs", type=int, default=1, help="campaigns at a time")
    arguments = parser.parse_args()
    folders = sorted(p.parent for p in data_folder().glob("*/campaign.toml"))
    wanted = [f for f in folders if arguments.only is None or f.name in arguments.only]
    if not wanted:
        raise SystemExit(f"{data_folder()}: no such campaign; there are {', '.join(f.name for f in folders) or 'none'}")
    rows = joblib.Parallel(arguments.jobs)(joblib.delayed(closed)(f, arguments.out) for f in wanted)
    print(table(rows))
    print(", ".join(f"{r.name} {r.processor_s:.0f} s" for r in rows), "of processor")
    if arguments.readme:
        readme = ROOT / "README.md"
        text = into_readme(readme.read_text(encoding="utf-8"), rows)
        write_whole(readme, lambda temporary: temporary.write_text(text, encoding="utf-8"))
        picture(rows).savefig(PICTURE, dpi=150)


if __name__ == "__main__":
    main()
