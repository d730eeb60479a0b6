"""What a cut may leave: the tolerances of a job as the stages use them."""

from __future__ import annotations

from dataclasses import dataclass

from conflank_cli.job import Tolerance


@dataclass(frozen=True, slots=True)
class Limits:
    """What the stages aim at, mm.

    over, under: how far the cut may lie below and above the face offset by `allowance`.
    """

    over: float
    under: float
    allowance: float = 0.0

    @property
    def middle(self) -> float:
        """Gap less allowance in the middle of the band, mm."""
        return 0.5 * (self.under - self.over)

    @classmethod
    def of(cls, tolerance: Tolerance) -> Limits:
        """The limits of a job: its allowance moved to where both sides have room.

        Every stage aims at zero, which nothing keeps to when one side is forbidden or nearly so (overcut = 0). So the
        aim moves away from a side that has less than a third of the band, until it has a third; a band with more room
        on both sides is aimed at as the job says.
        """
        over, under = tolerance.overcut, tolerance.undercut
        aim = max(under - 2.0 * over, 0.0) / 3.0 - max(over - 2.0 * under, 0.0) / 3.0
        return cls(over + aim, under - aim, tolerance.allowance + aim)
