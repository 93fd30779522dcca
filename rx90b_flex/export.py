"""Robots to files: identified inertias into a URDF, and a robot into a robot file that `load_robot` reads."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rx90b_flex import flexify as virtual
from rx90b_flex.bodies import Inconsistency, inconsistencies, moments_about_centre, pseudo_inertia
from rx90b_flex.effects import effect_to_table
from rx90b_flex.effects.motion import Array
from rx90b_flex.files.toml import toml_text
from rx90b_flex.robot import Robot

if TYPE_CHECKING:
    from yourdfpy.urdf import Inertial  # type: ignore[import-untyped, unused-ignore]

# Largest error of a parameter read back from the URDF, as a part of its body's largest one.
READ_BACK_TOLERANCE = 1e-9


def with_link_parameters(robot: Robot, link_parameters: Array, *, allow_inconsistent: bool = False) -> Robot:
    """The same robot whose moving bodies have other inertial parameters.

    The inertia of a body goes to its main link, the child of its joint; links behind fixed joints lose theirs, since
    it is counted there. Links fixed to the ground keep theirs. A body of ten zeros is written without inertia.

    Parameters
    ----------
    robot : Robot
    link_parameters : array, shape (10 * bodies,)
        In the order of `robot.bodies`, ten a body as `robot.link_parameters`; kg, kg m, kg m^2.
    allow_inconsistent : bool
        Whether bodies that cannot exist are written all the same.

    Raises
    ------
    ValueError
        Parameters that no body has (each link named with the smallest eigenvalue of its pseudo-inertia), or, allowed or
        not, that a URDF cannot hold: a negative mass, or none with a first moment.
    """
    names = [name for name, _ in robot.bodies]
    found = inconsistencies(link_parameters, names)
    if found and not allow_inconsistent:
        raise ValueError(_refusal(robot, found))
    urdf = virtual.read_xml(robot.urdf)
    links = {link.name: link for link in urdf.robot.links}
    behind: dict[str, list[str]] = {}
    for joint in urdf.robot.joints:
        if joint.type == "fixed":
            behind.setdefault(joint.parent, []).append(joint.child)
    bodies = np.asarray(link_parameters, dtype=float).reshape(-1, 10)
    for name, parameters in zip(names, bodies, strict=True):
        merged = list(behind.get(name, ()))
        while merged:
            link = merged.pop()
            links[link].inertial = None
            merged += behind.get(link, ())
        links[name].inertial = _inertial(robot, name, parameters)
    result = dataclasses.replace(robot, urdf=virtual.to_xml(urdf))
    _check_read_back(result, bodies)
    return result


def with_parameters(robot: Robot, parameters: Array, *, allow_inconsistent: bool = False) -> Robot:
    """The same robot with other values of all its linear parameters.

    Parameters
    ----------
    robot : Robot
    parameters : array, shape (p,)
        In the order of `robot.parameter_names`.
    allow_inconsistent : bool
        As for `with_link_parameters`, which raises what does not fit.
    """
    values = np.asarray(parameters, dtype=float)
    entries = robot.parameter_entries
    if values.shape != (len(entries),):
        raise ValueError(f"{robot.name}: parameters have shape {values.shape}; expected ({len(entries)},)")
    links = robot.link_parameters.copy()
    coefficients = [effect.coefficients for effect in robot.effects]
    for entry, value in zip(entries, values, strict=True):
        (links if entry.source < 0 else coefficients[entry.source])[entry.column] = value
    effects = [e.with_coefficients(c) for e, c in zip(robot.effects, coefficients, strict=True)]
    return with_link_parameters(robot, links, allow_inconsistent=allow_inconsistent).with_effects(effects)


def _inertial(robot: Robot, link: str, parameters: Array) -> Inertial | None:
    from yourdfpy.urdf import Inertial

    if not parameters.any():
        return None
    mass = float(parameters[0])
    if mass < 0 or (mass == 0 and parameters[1:4].any()):
        smallest = float(np.linalg.eigvalsh(pseudo_inertia(parameters))[0])
        raise ValueError(
            f"{robot.name}: {link}: a URDF holds the centre of mass s / m, so a mass of {mass:.4g} kg cannot be "
            f"written (smallest eigenvalue of the pseudo-inertia {smallest:.4g})"
        )
    if mass == 0:  # the centre does not matter: moments_about_centre at s = 0, whatever the mass
        centre, moments = moments_about_centre(np.r_[1.0, parameters[1:]])
    else:
        centre, moments = moments_about_centre(parameters)
    origin = np.eye(4)
    origin[:3, 3] = centre
    return Inertial(origin=origin, mass=mass, inertia=moments)


def _check_read_back(robot: Robot, bodies: Array) -> None:
    """A mass that is tiny beside the first moment costs digits in s / m; such a URDF must not pass unseen."""
    found = robot.link_parameters.reshape(bodies.shape)
    for (name, _), wanted, read in zip(robot.bodies, bodies, found, strict=True):
        worst = float(np.abs(read - wanted).max())
        if worst > READ_BACK_TOLERANCE * np.abs(wanted).max():
            raise ValueError(f"{robot.name}: {name}: the URDF gives the inertial parameters back only to {worst:.3g}")


def _refusal(robot: Robot, found: tuple[Inconsistency, ...]) -> str:
    return f"{robot.name}: not physically consistent: " + "; ".join(f.message for f in found)


# ---- robot files --------------------------------------------------------------------------------------------


def save_robot(
    robot: Robot, folder: str | os.PathLike[str], file_name: str = "robot.toml", *, allow_inconsistent: bool = False
) -> Path:
    """Write a robot file and its URDF, beside each other and with the same stem; `load_robot` gives the robot back.

    Both are written under temporary names first, so that a failure leaves what was there. Names of meshes stay as they
    are in the robot's URDF: relative ones are found only from where that came from.

    Parameters
    ----------
    robot : Robot
    folder : path
        Made if it does not exist.
    file_name : str
        Ends in ``.toml``.
    allow_inconsistent : bool
        Whether to write links that cannot exist. The robot file then says so in its first lines.

    Returns
    -------
    Path
        Of the robot file.

    Raises
    ------
    ValueError
        Inconsistent inertial parameters, an unusable file name, or a folder that cannot be written.
    """
    folder = Path(folder)
    if Path(file_name).name != file_name or Path(file_name).suffix != ".toml":
        raise ValueError(f"file_name is {file_name!r}; expected a name without folders that ends in .toml")
    found = inconsistencies(robot.link_parameters, [name for name, _ in robot.bodies])
    if found and not allow_inconsistent:
        raise ValueError(_refusal(robot, found))
    path = folder / file_name
    urdf_path = path.with_suffix(".urdf")
    notes = [f"# not physically consistent: {json.dumps(f.message)}\n" for f in found]
    # the robot file last: whoever sees it finds its URDF
    _write({urdf_path: robot.urdf, path: "".join(notes) + robot_file_text(robot, urdf_path.name)})
    return path


def robot_file_text(robot: Robot, urdf: str) -> str:
    """Text of a robot file (TOML) that points at `urdf`; every number reads back as the same double."""
    return toml_text(
        {
            "name": robot.name,
            "urdf": urdf,
            "tip_frame": robot.tip_frame,
            "inertial_parameters": robot.inertial_parameters,
            "controller": robot.controller or None,
            "effects": [effect_to_table(e) for e in robot.effects],
        }
    )


def _write(texts: Mapping[Path, str]) -> None:
    temporary = {path: path.with_name(f".{path.name}.{os.getpid()}.tmp") for path in texts}
    try:
        for path, text in texts.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary[path].write_text(text, encoding="utf-8")
        for path in texts:
            temporary[path].replace(path)
    except OSError as error:
        raise ValueError(f"{next(iter(texts)).parent}: cannot be written: {error.strerror}") from None
    finally:
        for path in temporary.values():
            if path.exists():
                path.unlink()
