"""Findings: what is wrong with a program, under codes that stay the same from version to version."""

from __future__ import annotations

from msgspec import Struct

CODES: dict[str, str] = {
    "CF101": "block not understood",
    "CF102": "word or block not followed",
    "CF103": "tool not stated in the program",
    "CF104": "frame not stated in the program",
    "CF105": "pose unknown",
    "CF106": "machine coordinates without a machine",
    "CF107": "reference point not stated in the program",
    "CF108": "rotary axes not followed",
    "CF109": "value impossible or inconsistent",
    "CF110": "program contradicts the job",
    "CF111": "no cutting move",
    "CF112": "feed unknown",
    "CF113": "tool centre point control misused",
    "CF114": "spindle",
    "CF115": "feed",
    "CF116": "way not proven",
    "CF117": "tolerance cycle",
    "CF118": "datum",
    "CF119": "not what the control sees",
    "CF120": "stop or rapid in contact",
    "CF121": "coolant",
    "CF201": "gouge",
    "CF202": "coverage missed",
    "CF203": "gouge next to the design faces",
    "CF301": "ball too near",
    "CF302": "cone too near",
    "CF303": "shank too near",
    "CF304": "holder too near",
    "CF401": "axis out of range",
    "CF402": "axis out of travel",
    "CF403": "axis too fast",
    "CF404": "axis acceleration",
    "CF405": "axis jerk",
}
"""1xx reading, 2xx cut, 3xx clearance, 4xx machine. A code never gets another meaning; new kinds get new numbers."""


class Finding(Struct, frozen=True, omit_defaults=False):
    """One thing that is wrong, and where.

    Attributes
    ----------
    code: stable code, see `CODES`.
    text: one sentence for a reader.
    block: number of the block in the program (its line where blocks are not numbered), if it has one.
    place: point in the CAD frame, mm, if it has one.
    amount, limit: the value found and the one allowed, in `unit`.
    unit: "um", "mm", "deg", "1", "mm/min", "mm/s", "mm/s2", "mm/s3", "deg/s", "deg/s2", "deg/s3" or "".
    count: how many times the same thing occurs; block and place are then those of the first or worst.
    """

    code: str
    text: str
    block: int | None = None
    place: tuple[float, float, float] | None = None
    amount: float | None = None
    limit: float | None = None
    unit: str = ""
    count: int = 1

    @property
    def title(self) -> str:
        """The code and what it stands for, e.g. ``CF201 gouge``."""
        return f"{self.code} {CODES[self.code]}"
