"""What a verification says, as it is written to ``<program>.verification.json``."""

from __future__ import annotations

import msgspec
from msgspec import Struct

from conflank_cli.verification.findings import Finding

SCHEMA = "conflank.verification"
SCHEMA_VERSION = 1

Triple = tuple[float, float, float]


class Pose(Struct, frozen=True):
    """The cutter where something happens, in the program's frame: tip (mm) and unit axis from tip to spindle."""

    tip: Triple
    axis: Triple


class Place(Struct, frozen=True):
    """Where something happens.

    Attributes
    ----------
    point: point on the part or obstacle, mm, CAD frame.
    face: CAD face number; -1 on meshes from elsewhere.
    block: block number; None where no pose comes near.
    share: how much of the block's way is done.
    pose: the cutter there.
    program: the called program that the block stands in; None for the program itself.
    """

    point: Triple
    face: int
    block: int | None = None
    share: float | None = None
    pose: Pose | None = None
    program: str | None = None


class GapFigures(Struct, frozen=True):
    """Absolute gap over the covered area, um; None where nothing is covered."""

    mean_abs: float | None
    p99_abs: float | None


class FaceFigures(Struct, frozen=True, omit_defaults=True):
    """One design face: number, trimmed area, share of it covered, and extremes; on a copy of the part its number."""

    face: int
    area_mm2: float
    coverage: float
    overcut_max_um: float
    stock_max_um: float | None
    copy: int | None = None


class CutFigures(Struct, frozen=True):
    """One sweep or pass, by itself.

    gap_min_um is the least gap wherever the cut reaches down to the tolerance (its overcut, if negative);
    gap_mean_abs_um and gap_max_um are over the area it covers, covered_mm2. length_mm is the way of the tip between the
    first and the last contact with that area, time_s the time of all its moves.
    """

    number: int
    tool: str
    length_mm: float
    covered_mm2: float
    gap_min_um: float | None
    gap_mean_abs_um: float | None
    gap_max_um: float | None
    time_s: float


class ClearanceFigures(Struct, frozen=True):
    """Least distance of one component to the part and to obstacles, mm; None where there is nothing within reach."""

    least: float | None
    at: Place | None


class Clearances(Struct, frozen=True):
    """Ball and cone against everything that must not be touched; shank and holder against the design faces as well."""

    ball: ClearanceFigures
    cone: ClearanceFigures
    shank: ClearanceFigures
    holder: ClearanceFigures


class Verification(Struct, frozen=True):
    """The judgement of one program. See docs and the attributes' own classes; lengths in the units their names end in.

    Attributes
    ----------
    schema, schema_version: what this file is.
    program, program_sha256: name of the file and hash of its text.
    judged: how it was judged: tools, frame, interpolation, machine and checked length of retracts.
    coverage, coverage_flank: covered share of the trimmed faces, by everything and without the passes.
    overcut_max_um, overcut_max_at: deepest overcut into the design faces or the faces next to them (0: none).
    stock_max_um, stock_max_at: most stock left anywhere on the design faces; None where no pose is known.
    gap_um: over the covered area.
    step_max_um: largest difference of the gap between neighbouring covered points that different cuts have made; None
        where no two patches meet.
    faces, sweeps, passes: the same by face and by cut. Of several copies the figures of a cut are those on the copy it
        covers most of, `gap_um` has the largest p99 of them, and points are where they are on that copy.
    clearance_mm: by component.
    time_s: of all moves whose way is known, with the speeds and accelerations of the job's machine.
    control_tolerance_um: T + h TA of the control's tolerance cycle, which comes on top at the machine; None where the
        program does not set it.
    unknown_moves: moves after a retract, whose poses the text does not tell (positioning off the part).
    findings: what is wrong; empty for a program that may run.
    called_sha256: hash of each program that it calls, by name of file; they are judged with it.
    """

    program: str
    program_sha256: str
    judged: dict[str, str | float]
    coverage: float
    coverage_flank: float
    overcut_max_um: float
    overcut_max_at: Place | None
    stock_max_um: float | None
    stock_max_at: Place | None
    gap_um: GapFigures
    step_max_um: float | None
    faces: tuple[FaceFigures, ...]
    sweeps: tuple[CutFigures, ...]
    passes: tuple[CutFigures, ...]
    clearance_mm: Clearances
    time_s: float
    control_tolerance_um: float | None
    unknown_moves: int
    findings: tuple[Finding, ...]
    called_sha256: dict[str, str] = {}
    schema: str = SCHEMA
    schema_version: int = SCHEMA_VERSION

    def to_json(self) -> bytes:
        """The judgement as JSON, indented, with a final newline."""
        return msgspec.json.format(msgspec.json.encode(self), indent=2) + b"\n"


def from_json(data: bytes) -> Verification:
    """Read a judgement back.

    Raises
    ------
    msgspec.ValidationError: the JSON is no judgement.
    """
    return msgspec.json.decode(data, type=Verification)
