"""The effect catalogue: one page per effect type, made from its class alone, so that a new effect needs no edit here."""

from __future__ import annotations

import inspect
import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import effect_pictures

from rx90b_flex.effects import Effect, Parameter, Sites, catalogue
from rx90b_flex.effects.tables import choices

SECTIONS = ("Signature", "Neighbours", "Source")
HEADINGS = ("Signature in the residual", "Told from its neighbours", "Source")
PLACES = {
    "forces": "a force of the robot",
    "coordinates": "adds coordinates to the robot",
    "signals": "between robot and log",
}
KINDS = {
    "linear": "the torque is proportional to it",
    "shape": "gives the torque its shape",
    "derived": "made from the coefficients that are fitted",
    "given": "stated, never estimated",
}
LEAD = """# Effect catalogue

A robot is a rigid tree and a list of effects. Each type has one page: what it is, its parameters, what it leaves in the residual of a
model that lacks it, and what tells it from its neighbours. All residuals side by side: [the gallery](gallery.md).
"""
SHOWN = """Made from the effect itself, on an arm that moves by a sum of harmonics and rests once, without noise: what it adds to a
joint's torque, less what constant, Coulomb and viscous friction can imitate of that, over time and over what it depends on most.
Its size is arbitrary, and spikes may leave the frame. An effect that adds coordinates and shows in no torque over time is drawn in
the frequency response of a drive."""
EXAMPLE = (
    "In a robot file (the numbers only show the form; what is left out is identified, but for what is never estimated):"
)
ANYWHERE = Sites(("joint_1", "joint_2"), "tool0")
KEYS = {
    "joint": 'joint = "joint_2"',
    "joints": 'joints = ["joint_5", "joint_6"]',
    "frame": 'frame = "tool0"',
    "robot": "",
    "robot or joint": 'joint = "joint_2"  # left out: all joints alike',
}


@dataclass(frozen=True)
class Text:
    """A class's docstring: what it is, and the text of each of `SECTIONS`."""

    what: str
    sections: tuple[str, ...]


def text_of(cls: type[Effect]) -> Text:
    """The parts of an effect's docstring.

    Raises
    ------
    ValueError
        The class, and the section that is missing or empty.
    """
    doc = inspect.cleandoc(cls.__dict__.get("__doc__") or "")
    found: dict[str, str] = {}
    parts = re.split(rf"^({'|'.join(SECTIONS)})\n-+\n", doc, flags=re.MULTILINE)
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        found[title] = body.strip()
    for title in SECTIONS:
        if not found.get(title):
            raise ValueError(f"{cls.__name__}: its docstring has no section {title!r}")
    return Text(parts[0].strip(), tuple(found[title] for title in SECTIONS))


def page(cls: type[Effect], picture: bool = False) -> str:
    """The page of an effect type, Markdown; with its picture from the gallery, which lies beside it."""
    text = text_of(cls)
    lines = [f"# `{cls.type_name()}`", "", _linked(text.what, cls), "", f"*{_place(cls)}.*", ""]
    if picture:
        lines += [f"![What {cls.type_name()} leaves in the residual]({cls.type_name()}.png)", "", SHOWN, ""]
    lines += ["## Parameters", ""]
    lines += ["| name | unit | bounds | |", "|---|---|---|---|"]
    for name, p in cls.parameters().items():
        size = f" [{p.size}]" if p.size > 1 else ""
        lines.append(f"| `{name}`{size} | {p.unit} | {_bounds(p)} | {KINDS[p.kind]} |")
    for name, words in choices(cls).items():
        said = ", ".join(f'`"{word}"`' for word in words)
        lines.append(f"| `{name}` | | {said} | stated; left out: {words[0]} |")
    lines += ["", EXAMPLE, "", "```toml", *_table(cls), "```", ""]
    for heading, body in zip(HEADINGS, text.sections, strict=True):
        lines += [f"## {heading}", "", _linked(body, cls), ""]
    return "\n".join(lines)


def index() -> str:
    """The catalogue's first page, Markdown."""
    lines = [LEAD]
    for place, words in PLACES.items():
        lines += [f"## {words[0].upper()}{words[1:]}", "", "| type | on | what it is |", "|---|---|---|"]
        for name, cls in catalogue().items():
            if _acts_on(cls) == place:
                first = " ".join(text_of(cls).what.split("\n\n")[0].split()).replace("``", "`").replace("|", "\\|")
                lines.append(f"| [`{name}`]({name}.md) | {cls.traits.on} | {first} |")
        lines.append("")
    return "\n".join([*lines, "```{toctree}", ":hidden:", "", "gallery", *catalogue(), "```", ""])


def gallery(drawn: Sequence[str]) -> str:
    """All pictures on one page, Markdown."""
    lines = ["# What each effect looks like in a residual", "", SHOWN, ""]
    for place, words in PLACES.items():
        names = [name for name in drawn if _acts_on(catalogue()[name]) == place]
        lines += [f"## {words[0].upper()}{words[1:]}", ""]
        for name in names:
            lines += [f"### [`{name}`]({name}.md)", "", f"![Residual with {name}]({name}.png)", ""]
    return "\n".join(lines)


def write_pages(folder: Path) -> None:
    """Write index and pages; files that are already right keep their time, so that a second build is quick."""
    folder.mkdir(exist_ok=True)
    drawn = [name for name, cls in catalogue().items() if effect_pictures.save(cls, folder / f"{name}.png")]
    pages = {"index": index(), "gallery": gallery(drawn)}
    pages |= {name: page(cls, name in drawn) for name, cls in catalogue().items()}
    for name, text in pages.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
    for path in folder.glob("*.md"):
        if path.stem not in pages:
            path.unlink()


def _acts_on(cls: type[Effect]) -> str:
    """Key of `PLACES`."""
    if cls.traits.virtual:
        return "coordinates"
    return "forces" if cls.traits.in_dynamics else "signals"


def _place(cls: type[Effect]) -> str:
    on = {"joint": "a joint", "joints": "two joints", "frame": "a frame", "robot": "the robot"}.get(
        cls.traits.on, f"the {cls.traits.on}"
    )
    said = [f"On {on}; {PLACES[_acts_on(cls)]}"]
    if cls.traits.replaces:
        said.append("stands in for " + " and ".join(f"`{name}`" for name in cls.traits.replaces) + " there")
    if cls.traits.needs:
        said.append("beside " + " and ".join(f"`{name}`" for name in cls.traits.needs))
    if cls.traits.repeats:
        said.append("may stand there more than once")
    searched = cls.everywhere(ANYWHERE)
    said.append("closing the loop tries it" if searched else "closing the loop on torques does not try it")
    return "; ".join(said)


def _linked(text: str, own: type[Effect]) -> str:
    """The docstring's text as Markdown: names of effect types become links to their pages."""
    text = text.replace("``", "\0")
    others = set(catalogue()) - {own.type_name()}
    text = re.sub(r"`(\w+)`", lambda m: f"[`{m[1]}`]({m[1]}.md)" if m[1] in others else m[0], text)
    return text.replace("\0", "`")


def _bounds(p: Parameter) -> str:
    low, high = (f"{x:g}" if abs(x) < float("inf") else "" for x in (p.lower, p.upper))
    if low and high:
        return f"{low} to {high}"
    return f"{low} or more" if low else ""


def _table(cls: type[Effect]) -> list[str]:
    """An effect in a robot file, with numbers that only show the form."""
    lines = ["[[effects]]", f'type = "{cls.type_name()}"', KEYS[cls.traits.on]]
    for name, p in cls.parameters().items():
        number = float(p.start) if isfinite(p.start) else 1.0
        # not alike: anchors must not meet
        several = ", ".join(f"{i * number:.6g}" for i in range(1, 1 + (p.size or 3)))
        value = f"{number}" if p.size == 1 else f"[{several}]"
        lines.append(f"{name} = {value}  # {p.unit}")
    return [line for line in lines if line]
