"""What a cut may leave: the tolerances of a job as the stages use them."""

from __future__ import annotations

from dataclasses import dataclass

from conflank_cli.job import Tolerance


@dataclass(frozen=True, slots=True)
class Limits:
    """What the stages aim at, mm.

    over, under: tolerance for overcut and stock left. allowance: stock to leave.
    """

    over: float
    under: float
    allowance: float = 0.0

    @classmethod
    def of(cls, tolerance: Tolerance) -> Limits:
        """The limits of a job."""
        return cls(tolerance.overcut, tolerance.undercut, tolerance.allowance)
