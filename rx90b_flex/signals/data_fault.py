"""What a log is refused with where the reason has a name."""

from __future__ import annotations


class DataFaultError(ValueError):
    """A log that is refused for a reason that has a name, as in ``check.json``.

    Attributes
    ----------
    kind, signal, joints, factor, rows : as `rx90b_flex.diagnose.faults.fault.DataFault` has them.
    """

    def __init__(
        self,
        message: str,
        kind: str,
        signal: str | None = None,
        joints: tuple[str, ...] = (),
        factor: float | None = None,
        rows: tuple[int, ...] = (),
    ) -> None:
        super().__init__(message)
        self.kind, self.signal, self.joints, self.factor, self.rows = kind, signal, joints, factor, rows
