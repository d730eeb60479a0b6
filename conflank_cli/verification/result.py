"""What a verification says, as it is written to ``<program>.verification.json``."""

from __future__ import annotations

import re

import msgspec
from msgspec import Struct

from conflank_cli.errors import InputError
from conflank_cli.verification.findings import CODES, Finding

SCHEMA = "conflank.verification"
SCHEMA_VERSION = 2

_MAKER = "a verification as conflank verify writes it"
_AGAIN = "Verify the program again: conflank verify PROGRAM --job JOB."
_SHA256 = re.compile("[0-9a-f]{64}")
_FILE_NAME = re.compile(r"(?!\.{1,2}$)[^/\\:\x00-\x1f]{1,255}")
"""Name of a file in the folder of the program: no way out of it."""

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


class FileHash(Struct, frozen=True, forbid_unknown_fields=True):
    """An input by name, and SHA-256 of its bytes; None where it was not read from a file."""

    name: str
    sha256: str | None


class Limits(Struct, frozen=True, forbid_unknown_fields=True):
    """What the cut was compared with.

    Attributes
    ----------
    overcut_mm, undercut_mm, allowance_mm: the job's tolerance.
    cutter_mm, shank_mm, holder_mm: distances to keep from obstacles.
    coverage: share of the faces to cover.
    """

    overcut_mm: float
    undercut_mm: float
    allowance_mm: float
    cutter_mm: float
    shank_mm: float
    holder_mm: float
    coverage: float


class Region(Struct, frozen=True, forbid_unknown_fields=True):
    """A design face that was judged: its number, the side of the cutter, and (u0, u1, v0, v1) of it as fractions."""

    face: int
    side: str
    region: tuple[float, float, float, float]


class Placement(Struct, frozen=True, forbid_unknown_fields=True):
    """How the part stands on the machine.

    Attributes
    ----------
    datum: number of the preset, or the shift of the datum from the active one, mm.
    rotate_deg, translate: from the CAD frame to that of the program, degrees and mm.
    copies_axis, copies_count: the rotary pattern.
    copies: numbers of the copies that were judged, in the order they are cut.
    """

    datum: int | Triple
    rotate_deg: Triple
    translate: Triple
    copies_axis: Triple
    copies_count: int
    copies: tuple[int, ...]


class Against(Struct, frozen=True, forbid_unknown_fields=True):
    """What a program was judged against.

    Attributes
    ----------
    program_version: version of conflank that judged.
    part, obstacles, machine: the files by name, with their hashes; of a shipped machine that of its file.
    job_sha256: of the resolved job, every default filled in, as JSON with sorted keys.
    limits, regions, placement: the parts of the job that say what is right.
    """

    program_version: str
    part: FileHash
    obstacles: tuple[FileHash, ...]
    machine: FileHash
    job_sha256: str
    limits: Limits
    regions: tuple[Region, ...]
    placement: Placement


class Verification(Struct, frozen=True, forbid_unknown_fields=True):
    """The judgement of one program. See docs and the attributes' own classes; lengths in the units their names end in.

    Attributes
    ----------
    schema, schema_version: what this file is.
    program, program_sha256: name of the file and hash of its text.
    against: what it was judged against: part, obstacles, job, machine, limits.
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
    unknown_moves: moves whose way is neither told by the text, nor followed on the machine, nor proven to be free.
    findings: what is wrong; empty for a program that may run.
    called_sha256: hash of each program that it calls, by name of file; they are judged with it.
    """

    program: str
    program_sha256: str
    against: Against
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


class _Schema(Struct, frozen=True):
    """The two keys that every version has."""

    schema: str
    schema_version: int


def from_json(data: bytes, where: str = "verification") -> Verification:
    """Read a verification back; `where` names its file in messages.

    Raises
    ------
    InputError: not JSON, another schema or version, keys that are missing, unknown or of another type, a code or hash
        that cannot be, or the name of a called program that leads out of the folder.
    """
    try:
        head = msgspec.json.decode(data, type=_Schema)
        if head.schema != SCHEMA:
            raise InputError(f"{where}: schema", repr(head.schema), repr(SCHEMA), _AGAIN)
        if head.schema_version != SCHEMA_VERSION:
            raise InputError(f"{where}: schema_version", str(head.schema_version), str(SCHEMA_VERSION), _AGAIN)
        verification = msgspec.json.decode(data, type=Verification)
    except msgspec.ValidationError as error:
        raise _wrong_type(str(error), where) from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(where, f"invalid JSON ({error})", _MAKER, _AGAIN) from None
    except RecursionError:
        raise InputError(where, "JSON that is nested too deeply", _MAKER, _AGAIN) from None
    _check(verification, where)
    return verification


def _wrong_type(message: str, where: str) -> InputError:
    """Translate `Expected `int`, got `str` - at `$.a.b``; other messages of msgspec stay as they are."""
    reason, _, place = message.partition(" - at `$")
    key = place.rstrip("`").removeprefix(".")
    where = f"{where}: {key}" if key else where
    types = re.fullmatch(r"Expected (.+), got (.+)", reason.replace("`", ""))
    if types is not None:
        return InputError(where, types[2], types[1], _AGAIN)
    return InputError(where, f"JSON that is no verification ({reason})", _MAKER, _AGAIN)


def _check(verification: Verification, where: str) -> None:
    """Refuse what the types allow and conflank never writes."""
    against = verification.against
    files = {"part": against.part, "machine": against.machine}
    files |= {f"obstacles[{k}]": each for k, each in enumerate(against.obstacles)}
    hashes = {"program_sha256": verification.program_sha256, "against.job_sha256": against.job_sha256}
    hashes |= {f"against.{key}.sha256": each.sha256 for key, each in files.items() if each.sha256 is not None}
    hashes |= {f"called_sha256.{name}": digest for name, digest in verification.called_sha256.items()}
    for name in verification.called_sha256:
        if _FILE_NAME.fullmatch(name) is None:
            expected = "the name of a file in the program's folder"
            raise InputError(f"{where}: called_sha256", repr(name), expected, _AGAIN)
    for key, digest in hashes.items():
        if _SHA256.fullmatch(digest) is None:
            raise InputError(f"{where}: {key}", repr(digest), "64 hexadecimal digits", _AGAIN)
    if verification.unknown_moves < 0:
        raise InputError(f"{where}: unknown_moves", str(verification.unknown_moves), "a number >= 0", _AGAIN)
    for k, finding in enumerate(verification.findings):
        if finding.code not in CODES:
            raise InputError(f"{where}: findings[{k}].code", repr(finding.code), "a code of this version", _AGAIN)
