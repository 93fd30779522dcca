"""What is wrong with data, or with what is stated about them, where the reason has a name."""

from __future__ import annotations

from dataclasses import dataclass, field

KINDS = (
    "swapped_columns", "reversed_sign", "unit", "torque_gain", "time_shift", "sample_rate", "clipped", "stuck", "glitch",
    "repeated_recording", "unrelated", "kinematics", "no_excitation",
)  # fmt: skip


@dataclass(frozen=True)
class DataFault:
    """Something wrong with the data, or with what is stated about them.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    signal : str or None
        Key of a campaign file (``torque``, ``motor_position``), ``all``, or None where it is no signal's.
    joints : tuple of str
    factor : float or None
        What is stated over what is true; s for a shift, rad for a zero.
    std : float or None
        Of the factor.
    message : str
        One sentence with the cure.
    usable : bool
        Whether the data can be used all the same.
    error_before, error_after : float or None
        Relative torque error of the rigid model on held-out rows, as the file has it and with the fault mended.
    rows : tuple of int
        Data rows of a glitch, counted from 1.
    """

    kind: str
    signal: str | None
    joints: tuple[str, ...]
    factor: float | None = field(default=None, kw_only=True)
    std: float | None = field(default=None, kw_only=True)
    message: str
    usable: bool = False
    error_before: float | None = None
    error_after: float | None = None
    rows: tuple[int, ...] = ()


class DataFaultError(ValueError):
    """A log that is refused for a reason that has a name: its `fault`, as in ``check.json``."""

    def __init__(self, fault: DataFault) -> None:
        super().__init__(fault.message)
        self.fault = fault
