"""What the name of a column says: words that stand for a signal, for time, or for nothing."""

from __future__ import annotations

from collections.abc import Sequence

from rx90b_flex.signals.units import TIME_UNITS, UNIT_WORDS, words_of

# words in names, in lower case
# fmt: off
_POSITION = {"q", "pos", "jpos", "aipos", "position", "positions", "ang", "angle", "angles", "theta", "phi", "enc", "encoder",
             "istposition", "winkel", "drehwinkel", "istwinkel"}
_VELOCITY = {"v", "qd", "dq", "qp", "qdot", "vel", "velocity", "velocities", "speed", "omega", "refv", "drehzahl",
             "geschwindigkeit", "vitesse"}
_TORQUE = {"tau", "torque", "torques", "effort", "efforts", "eff", "trq", "jtrq", "moment", "ff", "feedforward", "drehmoment",
           "motormoment", "istmoment", "couple"}
FORCE = {"force", "forces", "kraft", "thrust"}  # of joints that slide: elsewhere they are a sensor's at the tool
_FORWARD = {"ff", "feedforward"}
_REFERENCE = {"ref", "reference", "refv", "des", "desired", "cmd", "command", "commanded", "set", "setpoint", "target", "sp",
              "soll", "sollposition", "sollwinkel", "consigne"}
_LINK = {"link", "load", "output", "secondary"}
_CURRENT = {"current", "currents", "amp", "amps", "macur"}
_OTHER = {"qdd", "ddq", "qddot", "ddot", "acc", "accel", "acceleration", "temp", "temperature", "voltage",
          # what controllers log beside the measured signals
          "limit", "limits", "error", "err", "friction", "external", "ext", "control"}
_NOISE = {"joint", "joints", "axis", "motor", "act", "actual", "meas", "measured", "data", "log", "state", "states", "arm", "robot",
          "drive", "achse", "axe", "ist", "per", "dot", "j", "m", "n", "s", "rad", "nm"}
_TIMES = {"time", "t", "timestamp", "stamp", "times", "clock", "seconds", "secs", "sec", "zeit", "zeitstempel", "temps", "datetime"}
# what stands in brackets and is no unit, beside the words above
_ASIDE = {"filtered", "filt", "unfiltered", "raw", "lowpass", "lp", "left", "right", "upper", "lower", "front", "rear", "main",
          "estimated", "estimate", "est", "calculated", "calc", "computed", "smoothed", "smooth", "mean", "avg", "average",
          "side", "input", "out", "signal", "channel", "ch", "value", "val", "real", "lreal", "double", "float", "sim",
          "simulated", "model", "corrected", "corr", "abs", "absolute", "rel", "relative", "incremental", "gear", "sensor", "plc",
          "controller", "internal", "base", "shoulder", "elbow", "wrist", "tool", "tcp", "flange", "gripper", "hand", "head",
          "torso", "leg", "hip", "knee", "ankle", "foot", "finger", "master", "slave", "leader", "follower", "total", "sum",
          "net", "roll", "pitch", "yaw", "si", "optional", "new", "old"}
# fmt: on
_TORQUES = ("nm", "mnm", "cnm", "knm", "ncm", "nmm")
# names of one letter with their units
_OF_LETTERS: dict[tuple[str, ...], str] = {
    **{("i", u): "motor_current" for u in ("a", "ma")},
    **{(x, u): "torque" for x in "mt" for u in _TORQUES},
    **{("f", u): "torque" for u in ("n", "kn")},
    **{(x, "mm"): "motor_position" for x in "jaq"},
}


# words in brackets that are no units
NO_UNITS = (_POSITION | _VELOCITY | _TORQUE | FORCE | _REFERENCE | _LINK | _CURRENT | _OTHER | _NOISE | _TIMES | _ASIDE) - {
    "j", "m", "n", "s", "per", "rad", "nm"
}  # fmt: skip


def time_words(name: str) -> list[str]:
    """`log.time_ms` gives time, ms."""
    return [w for w in words_of(name) if w in _TIMES or w in TIME_UNITS or w not in _NOISE]


def is_time(name: str) -> bool:
    """Whether a name says time, with its unit or without, and nothing else."""
    words = time_words(name)
    return bool(words) and words[0] in _TIMES and all(w in _TIMES or w in TIME_UNITS for w in words)


def find_words(part: Sequence[str], words: Sequence[str]) -> tuple[int, int] | None:
    """Where some words stand among others, one behind the other: the first place and the one past the last; None: nowhere."""
    for start in range(len(words) - len(part) + 1):
        if list(words[start : start + len(part)]) == list(part):
            return start, start + len(part)
    return None


def signal_of(words: Sequence[str]) -> tuple[str | None, list[str]]:
    """The signal that words stand for, and the words that say nothing known."""
    kinds = set(words)
    if kinds & _OTHER:
        return None, []
    if kinds & _CURRENT:
        return ("motor_current" if not kinds & (_REFERENCE | _FORWARD) else None), [
            w for w in words if w not in _CURRENT | _NOISE and not w.isdigit()
        ]
    known = _POSITION | _VELOCITY | _TORQUE | _REFERENCE | _LINK | _NOISE | UNIT_WORDS
    left = [w for w in words if w not in known and not w.isdigit()]
    wanted = bool(kinds & _REFERENCE)
    if kinds & _TORQUE:
        if wanted and not kinds & _FORWARD:
            return None, left  # what the controller asked of the motors is neither measured nor fed forward
        return ("feedforward_torque" if kinds & _FORWARD else "torque"), left
    if kinds & _VELOCITY or (kinds & _POSITION and "dot" in kinds):
        if kinds & _LINK:
            return None, left
        return ("reference_velocity" if wanted else "motor_velocity"), left
    if kinds & _LINK and not wanted:
        return ("link_position" if kinds & _POSITION or not kinds & {"load", "output"} else None), left
    if wanted:
        return "reference_position", left
    if kinds & _POSITION:
        return "motor_position", left
    return _by_unit(words, left), left


def _by_unit(words: Sequence[str], left: Sequence[str]) -> str | None:
    """The signal that a unit tells where a name says nothing else: `AxisAct.A1 [deg]`, `M1 [Nm]`, `I1 [A]`; None: none."""
    kinds = set(words)
    if kinds & {"s", "per", "dot", "min", "h"}:
        return None
    if (kinds & {"deg", "degree", "degrees", "grad", "rad"} or {"axis", "act"} <= kinds) and set(left) <= {"a"}:
        return "motor_position"
    letters = [w for w in words if not w.isdigit()]
    if len(letters) == 1:  # a joint's name and a unit
        return {"mm": "motor_position", **dict.fromkeys(_TORQUES, "torque")}.get(letters[0])
    return _OF_LETTERS.get(tuple(letters))


def unnumbered(name: str) -> tuple[str, ...]:
    """What columns of several joints have in common: the words of a name without its numbers."""
    return tuple(w for w in words_of(name) if not w.isdigit())
