"""Effects as tables of robot files, and the catalogue of all effect types."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rx90b_flex.effects.effect import Effect, FrameEffect
from rx90b_flex.effects.parameters import Parameter
from rx90b_flex.effects.stand_in import form_stated
from rx90b_flex.effects.trials import why_not
from rx90b_flex.files.extensions import EFFECTS, brought, concrete, import_all, own, subclasses, wrong_class
from rx90b_flex.files.keys import check_keys, close_match


def catalogue() -> dict[str, type[Effect]]:
    """All effect types by name: every concrete subclass of `Effect` in the modules of this folder, and what other packages bring.

    Those name a class in the entry point group ``rx90b_flex.effects``.
    """
    import_all("rx90b_flex.effects")
    others = brought(EFFECTS, _why_no_type)
    found: dict[str, type[Effect]] = {}
    for sub in filter(concrete, subclasses(Effect)):
        name = sub.type_name()
        if own(sub) or (not others.left_out(sub) and (name not in found or not own(found[name]))):
            found[name] = sub
    return dict(sorted(found.items()))


def _why_no_type(found: Any) -> str:
    """What is wrong with an effect type that another package brings; empty: nothing."""
    wrong = wrong_class(found, Effect)
    if not wrong and any(own(sub) and sub.__name__ == found.__name__ for sub in subclasses(Effect)):
        return f"there is an effect type {found.type_name()!r} already"
    return wrong or why_not(found)


def choices(cls: type[Effect]) -> dict[str, tuple[str, ...]]:
    """Words that an effect type may be given in a robot file, by name, the usual one first."""
    return {f.name: f.metadata["choice"] for f in dataclasses.fields(cls) if "choice" in f.metadata}


def effect_from_table(
    table: Mapping[str, Any], where: str, joints: Sequence[str], frames: Sequence[str] = ()
) -> Effect:
    """Make an effect from a table of a robot file.

    Parameters
    ----------
    table : mapping
        ``type``, the place, and parameter values.
    where : str
        Named in errors: the file and the entry.
    joints, frames : sequence of str
        Names that exist.

    Raises
    ------
    ValueError
        Unknown type, key, joint or frame; a value of the wrong kind or number.
    """
    types = catalogue()
    if "type" not in table:
        raise ValueError(f"{where}: key 'type' is missing")
    if not isinstance(table["type"], str) or table["type"] not in types:
        kind = str(table["type"])
        why = brought(EFFECTS, _why_no_type).why_missing(kind) or f"; {close_match(kind, list(types))}"
        raise ValueError(f"{where}: unknown effect type {table['type']!r}{why}")
    cls = form_stated(types[table["type"]], table)
    where = f"{where} ({cls.type_name()})"
    key = {"robot": "", "robot or joint": "joint"}.get(cls.traits.on, cls.traits.on)
    check_keys(table, ["type", *filter(None, [key]), *cls.parameters(), *choices(cls)], where)
    values: dict[str, Any] = {}
    if key in table:
        values |= _read_place(key, table[key], where, joints, frames)
    elif cls.traits.on not in ("robot", "robot or joint"):
        raise ValueError(f"{where}: key {key!r} is missing")
    for name, parameter in cls.parameters().items():
        if name in table:
            values[parameter.attribute] = _read_value(table[name], parameter, f"{where}: {name}")
        elif parameter.kind == "given":
            raise ValueError(f"{where}: key {name!r} is missing; it cannot be identified")
    for name, words in choices(cls).items():
        if name in table:
            if table[name] not in words:
                raise ValueError(f"{where}: {name} is {table[name]!r}; {close_match(str(table[name]), words)}")
            values[name] = table[name]
    try:
        return cls(**values)
    except ValueError as error:  # values that do not go together
        raise ValueError(f"{where}: {error}") from error


def _read_place(key: str, found: Any, where: str, joints: Sequence[str], frames: Sequence[str]) -> dict[str, Any]:
    pair = key == "joints"
    if pair and (not isinstance(found, list) or len(found) != 2 or found[0] == found[1]):
        raise ValueError(f"{where}: joints is {found!r}; expected two different joints [a, b]")
    kind, known = ("frame", frames) if key == "frame" else ("joint", joints)
    for name in found if pair else [found]:
        if name not in known:
            raise ValueError(f"{where}: unknown {kind} {name!r}; {close_match(str(name), known)}")
    return {"joint_pair": tuple(found)} if pair else {kind: found}


def _read_value(found: Any, parameter: Parameter, where: str) -> Any:
    # a pure number has no unit to print
    unit, unit_after = (f" in {parameter.unit}", f" {parameter.unit}") if parameter.unit != "-" else ("", "")
    if parameter.size == 1:
        if isinstance(found, bool) or not isinstance(found, int | float) or not np.isfinite(found):
            raise ValueError(f"{where} is {found!r}; expected one finite number{unit}")
        if parameter.kind == "shape" and not parameter.lower <= found <= parameter.upper:
            raise ValueError(f"{where} is {found!r}; expected {parameter.lower:g} to {parameter.upper:g}{unit_after}")
        if found < parameter.lower:
            raise ValueError(f"{where} is {found!r}; expected at least {parameter.lower:g}{unit_after}")
        return float(found)
    try:
        values = np.asarray(found, dtype=float)
    except (TypeError, ValueError):
        values = np.array([])
    if values.size != (parameter.size or max(1, values.size)) or not np.isfinite(values).all():
        raise ValueError(f"{where} is {found!r}; expected {parameter.size or 'some'} finite numbers{unit}")
    if (values < parameter.lower).any():
        raise ValueError(f"{where} is {found!r}; expected at least {parameter.lower:g}{unit_after}")
    if (values > parameter.upper).any():
        raise ValueError(f"{where} is {found!r}; expected at most {parameter.upper:g}{unit_after}")
    return tuple(float(x) for x in values.ravel())


def effect_to_table(effect: Effect) -> dict[str, Any]:
    """The table of a robot file that `effect_from_table` turns into this effect; values that are not known are left out."""
    table: dict[str, Any] = {"type": effect.type_name()}
    if effect.traits.on in ("joint", "robot or joint") and effect.joints:
        table["joint"] = effect.joints[0]
    elif effect.traits.on == "joints":
        table["joints"] = list(effect.joints)
    elif isinstance(effect, FrameEffect):
        table["frame"] = effect.frame
    for name, parameter in effect.parameters().items():
        value = getattr(effect, parameter.attribute)
        if value is not None:
            table[name] = list(value) if isinstance(value, tuple) else float(value)
    said = {name: (getattr(effect, name), usual) for name, (usual, *_) in choices(type(effect)).items()}
    return table | {name: word for name, (word, usual) in said.items() if word != usual}
