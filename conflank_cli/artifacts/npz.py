"""Artifacts as NPZ files without pickles: the scene, the sweeps, in a plan the passes, and a summary.

The array `meta` holds a JSON document in UTF-8 (`Document`): schema name and version, units, the resolved job, hashes
of the inputs, the version of the program, and the meaning of the other arrays:

- per design face i: ``face<i>_knots_u``, ``face<i>_knots_v``, ``face<i>_poles`` (nu, nv, 3), ``face<i>_weights``
  (nu, nv) where rational, ``face<i>_loops`` (N, 2) and ``face<i>_loop_offsets`` (loops + 1,);
- per face i next to the design faces the same as ``around<i>_...``, and per piece i of what is left of a design face
  outside its regions as ``rest<i>_...``;
- ``check_vertices`` (N, 3), ``check_triangles`` (M, 3), ``check_face`` (M,);
- in a plan, per design face i, what it covers point by point (`FaceCoverage`): ``face<i>_coverage_uv`` (N, 2),
  ``face<i>_coverage_points`` (N, 3), ``face<i>_coverage_areas``, ``face<i>_coverage_sweep`` and
  ``face<i>_coverage_reason`` (N,);
- ``motion_offsets`` (sweeps + 1,): sweep k has control points o[k] to o[k + 1] of ``motion_p`` and ``motion_q``
  (N, 3), and knots o[k] + 4 k to o[k + 1] + 4 (k + 1) of ``motion_knots``;
- with passes ``pass_offsets`` (passes + 1,): pass k has poses o[k] to o[k + 1] of ``pass_tip`` and ``pass_axis``
  (N, 3).
"""

from __future__ import annotations

import io
import sys
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Struct

from conflank_cli import __version__
from conflank_cli.ball_pass import Pass
from conflank_cli.coverage import FaceCoverage, Reason
from conflank_cli.errors import InputError, NumericalError
from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.job import job_from_builtins
from conflank_cli.motion import DEGREE, Motion
from conflank_cli.once import Once
from conflank_cli.output import STANDARD, check_output, write_output
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Section, Tool

Kind = Literal["candidates", "motions", "plan"]
KINDS: tuple[Kind, ...] = ("candidates", "motions", "plan")
MAKERS: Mapping[str, str] = {"candidates": "detect", "motions": "optimize", "plan": "select"}
"""The stage that writes each kind."""

SCHEMA_VERSION = 2
UNIT_SLACK = 1e-6
"""Axes of passes are unit vectors within this."""
UNITS: Mapping[str, str] = {"length": "mm", "angle": "rad"}
# The zip format cannot hold an earlier date; any fixed one makes equal inputs give equal bytes.
_ZIP_MAGIC = b"PK\x03\x04"
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)


# Arrays of `FaceCoverage` and their shapes; those that hold whole numbers.
_COVERAGE: Mapping[str, tuple[int | None, ...]] = {
    "uv": (None, 2),
    "points": (None, 3),
    "areas": (None,),
    "sweep": (None,),
    "reason": (None,),
}
_COVERAGE_NUMBERS = ("sweep", "reason")


class FaceEntry(Struct, frozen=True, forbid_unknown_fields=True):
    """What a face is besides its arrays."""

    number: int
    name: str
    degree_u: int
    degree_v: int
    rational: bool
    sense: Literal[-1, 1]


class SectionEntry(Struct, frozen=True, forbid_unknown_fields=True):
    """A section of shank or holder, mm."""

    diameter_low: float
    diameter_high: float
    length: float


class ToolEntry(Struct, frozen=True, forbid_unknown_fields=True):
    """A tool of the drawer, mm."""

    name: str
    r_min: float
    r_max: float
    length: float
    shank: tuple[SectionEntry, ...]
    holder: tuple[SectionEntry, ...]
    number: int
    spindle_rpm: float
    feed_mm_min: float


class SweepEntry(Struct, frozen=True, forbid_unknown_fields=True):
    """What a sweep is besides its motion."""

    face: int
    tool: str
    facts: dict[str, float]


class PassEntry(Struct, frozen=True, forbid_unknown_fields=True):
    """What a pass is besides its poses."""

    face: int
    tool: str
    facts: dict[str, float]


class Document(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The JSON document of an artifact; `schema` is "conflank/" and the kind."""

    schema: str
    version: int
    program_version: str
    units: dict[str, str]
    job: dict[str, Any]
    inputs: dict[str, str]
    part_name: str
    faces: tuple[FaceEntry, ...]
    tools: tuple[ToolEntry, ...]
    sweeps: tuple[SweepEntry, ...]
    summary: dict[str, Any]
    passes: tuple[PassEntry, ...] = ()
    around: tuple[FaceEntry, ...] = ()
    rest: tuple[FaceEntry, ...] = ()

    def surfaces(self) -> list[tuple[str, FaceEntry]]:
        """Every face that has arrays, with what their names begin with."""
        groups = (("face", self.faces), ("around", self.around), ("rest", self.rest))
        return [(f"{name}{index}", entry) for name, group in groups for index, entry in enumerate(group)]


class Contents(NamedTuple):
    """What an artifact holds; only a plan has passes."""

    kind: Kind
    scene: Scene
    sweeps: tuple[Sweep, ...]
    passes: tuple[Pass, ...]
    summary: dict[str, Any]


class _Schema(Struct, frozen=True):
    """The two fields that every version of every schema has."""

    schema: str
    version: int


def write_artifact(
    kind: Kind,
    scene: Scene,
    sweeps: Sequence[Sweep],
    summary: Mapping[str, object],
    out: str | Path,
    inputs: Iterable[str | Path] = (),
    *,
    coverage: Sequence[FaceCoverage] = (),
    passes: Sequence[Pass] = (),
) -> None:
    """Write an artifact to the file `out`, or to standard output for "-".

    Parameters
    ----------
    kind: what the sweeps are.
    scene, sweeps: what the next stage needs.
    summary: what the stage found, JSON values only.
    out: file, replaced if it exists.
    inputs: files that must not be replaced.
    coverage: of a plan, one for each design face, or none.
    passes: those of a plan.

    Raises
    ------
    UsageError: the output is an input, or binary data would go to a terminal.
    NumericalError: a number to write is not finite.
    """
    check_output(out, inputs, binary=True)
    write_output(encode_artifact(kind, scene, sweeps, summary, coverage=coverage, passes=passes), out, inputs)


def encode_artifact(
    kind: Kind,
    scene: Scene,
    sweeps: Sequence[Sweep],
    summary: Mapping[str, object],
    *,
    coverage: Sequence[FaceCoverage] = (),
    passes: Sequence[Pass] = (),
) -> bytes:
    """The bytes of an artifact. Equal arguments give equal bytes."""
    arrays: dict[str, npt.NDArray[Any]] = {}
    for group, members in (("face", scene.faces), ("around", scene.neighbours), ("rest", scene.rest)):
        for index, face in enumerate(members):
            arrays |= _face_arrays(f"{group}{index}", face)
    for index, covered in enumerate(coverage):
        for name in _COVERAGE:
            array = getattr(covered, name)
            arrays[f"face{index}_coverage_{name}"] = (
                np.ascontiguousarray(array, dtype="<i4") if name in _COVERAGE_NUMBERS else _floats(array)
            )
    arrays["check_vertices"] = _floats(scene.check.vertices)
    arrays["check_triangles"] = np.ascontiguousarray(scene.check.triangles, dtype="<i4")
    arrays["check_face"] = np.ascontiguousarray(scene.check.face, dtype="<i4")
    arrays["motion_offsets"] = _offsets([sweep.motion.p for sweep in sweeps])
    arrays["motion_knots"] = np.concatenate([np.empty(0, "<f8"), *(sweep.motion.knots for sweep in sweeps)])
    arrays["motion_p"] = _joined([sweep.motion.p for sweep in sweeps], 3)
    arrays["motion_q"] = _joined([sweep.motion.q for sweep in sweeps], 3)
    if passes:
        arrays["pass_offsets"] = _offsets([item.tip for item in passes])
        arrays["pass_tip"] = _joined([item.tip for item in passes], 3)
        arrays["pass_axis"] = _joined([item.axis for item in passes], 3)
    for name, array in arrays.items():
        if not np.all(np.isfinite(array)):
            raise NumericalError(
                f"{kind}: {name}", "a number that is not finite", "finite numbers", "Please report this job."
            )
    document = Document(
        schema=f"conflank/{kind}",
        version=SCHEMA_VERSION,
        program_version=__version__,
        units=dict(UNITS),
        job=msgspec.to_builtins(scene.job),
        inputs=dict(scene.inputs),
        part_name=scene.part_name,
        faces=tuple(_face_entry(face) for face in scene.faces),
        tools=tuple(_tool_entry(tool) for tool in scene.tools),
        sweeps=tuple(
            SweepEntry(sweep.face, sweep.tool, {name: float(value) for name, value in sweep.facts.items()})
            for sweep in sweeps
        ),
        summary=dict(summary),
        passes=tuple(
            PassEntry(item.face, item.tool, {name: float(value) for name, value in item.facts.items()})
            for item in passes
        ),
        around=tuple(_face_entry(face) for face in scene.neighbours),
        rest=tuple(_face_entry(face) for face in scene.rest),
    )
    for place, entry in (
        ("summary", document.summary),
        *((f"sweep {k}", s.facts) for k, s in enumerate(document.sweeps)),
        *((f"pass {k}", s.facts) for k, s in enumerate(document.passes)),
    ):
        _refuse_not_finite(entry, f"{kind}: {place}")
    text = msgspec.json.encode(document, enc_hook=_plain, order="deterministic")
    arrays["meta"] = np.frombuffer(text, dtype=np.uint8)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(arrays):
            entry_info = zipfile.ZipInfo(f"{name}.npy", _ZIP_DATE)
            with archive.open(entry_info, "w") as stream:
                np.lib.format.write_array(stream, arrays[name], allow_pickle=False)
    return buffer.getvalue()


def read_artifact(source: str | Path, expected: Kind | None = None) -> tuple[Scene, tuple[Sweep, ...], dict[str, Any]]:
    """Read an artifact from a file, or from standard input for "-".

    Parameters
    ----------
    source: file name or "-".
    expected: the kind that is wanted; None for any.

    Returns
    -------
    the scene, the sweeps and the summary.

    Raises
    ------
    InputError: no such file, no artifact, another kind or version, or arrays that contradict the document.
    """
    where, data = read_source(source)
    _, scene, sweeps, summary = decode_artifact(data, where, expected)
    return scene, sweeps, summary


def read_plan(source: str | Path) -> Contents:
    """Read a plan with its passes from a file, or from standard input for "-"; raises what `read_artifact` does."""
    where, data = read_source(source)
    return decode_contents(data, where, "plan")


def read_source(source: str | Path) -> tuple[str, bytes]:
    """The name for messages and the bytes of a file, or of standard input for "-"."""
    if str(source) == STANDARD:
        return "standard input", sys.stdin.buffer.read()
    try:
        return Path(source).name, Path(source).read_bytes()
    except OSError as error:
        raise InputError(
            str(source), f"no readable file ({error.strerror})", "a file", "Check the name and the folder."
        ) from None


def decode_artifact(
    data: bytes, where: str, expected: Kind | None = None
) -> tuple[Kind, Scene, tuple[Sweep, ...], dict[str, Any]]:
    """Kind, scene, sweeps and summary from the bytes of an artifact; `where` names it in messages."""
    contents = decode_contents(data, where, expected)
    return contents.kind, contents.scene, contents.sweeps, contents.summary


def decode_contents(data: bytes, where: str, expected: Kind | None = None) -> Contents:
    """Everything in the bytes of an artifact; `where` names it in messages."""
    arrays = _load_arrays(data, where, expected)
    kind = _check_schema(arrays, where, expected)
    try:
        document = msgspec.json.decode(arrays.pop("meta").tobytes(), type=Document)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise _damaged(where, f"a document that does not fit its schema ({error})") from None
    if document.units != UNITS:
        raise _damaged(where, f"units {document.units}")
    _check_arrays(arrays, document, where)
    faces, around, rest = (
        tuple(_face(entry, arrays, f"{group}{index}") for index, entry in enumerate(members))
        for group, members in (("face", document.faces), ("around", document.around), ("rest", document.rest))
    )
    check = CheckMesh(
        arrays["check_vertices"],
        arrays["check_triangles"].astype(np.int32),
        arrays["check_face"].astype(np.int32),
    )
    job = job_from_builtins(document.job, where)
    tools = tuple(_tool(entry) for entry in document.tools)
    scene = Scene(
        job, document.part_name, faces, tools, Once(lambda: check), document.inputs, rest, Once(lambda: around)
    )
    return Contents(kind, scene, _sweeps(document.sweeps, arrays), _passes(document.passes, arrays), document.summary)


def decode_coverage(data: bytes, where: str) -> tuple[FaceCoverage, ...]:
    """What a plan covers of each design face, from the bytes of an artifact; none where it has none."""
    scene = decode_contents(data, where, "plan").scene
    arrays = _load_arrays(data, where, "plan")
    if "face0_coverage_uv" not in arrays:
        return ()
    return tuple(
        FaceCoverage(*(arrays[f"face{index}_coverage_{name}"] for name in _COVERAGE))
        for index in range(len(scene.faces))
    )


def document_text(data: bytes, where: str) -> str:
    """The JSON document of an artifact as it stands in the file, after all checks."""
    decode_contents(data, where)
    return str(_load_arrays(data, where, None)["meta"].tobytes().decode("utf-8"))


# --- writing --------------------------------------------------------------------------------------------------------


def _floats(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.ascontiguousarray(array, dtype="<f8")


def _joined(parts: Sequence[npt.NDArray[Any]], width: int) -> npt.NDArray[Any]:
    return np.concatenate([np.empty((0, width), "<f8"), *parts])


def _offsets(parts: Sequence[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    return np.cumsum([0, *(len(part) for part in parts)], dtype="<i8")


def _plain(value: Any) -> Any:
    """NumPy scalars and arrays in summaries as JSON values."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no JSON value")


def _refuse_not_finite(value: Any, where: str) -> None:
    """JSON has no NaN; writing null instead would lose the fact that something went wrong."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            _refuse_not_finite(item, f"{where}: {key}")
    elif isinstance(value, list | tuple):
        for item in value:
            _refuse_not_finite(item, where)
    elif isinstance(value, float | np.floating | np.ndarray) and not np.all(np.isfinite(value)):
        raise NumericalError(where, f"{value}", "a finite number", "Please report this job.")


def _face_arrays(name: str, face: DesignFace) -> dict[str, npt.NDArray[Any]]:
    surface = face.surface
    arrays = {
        f"{name}_knots_u": _floats(surface.knots_u),
        f"{name}_knots_v": _floats(surface.knots_v),
        f"{name}_poles": _floats(surface.poles),
        f"{name}_loops": _joined(face.loops, 2),
        f"{name}_loop_offsets": _offsets(face.loops),
    }
    if surface.weights is not None:
        arrays[f"{name}_weights"] = _floats(surface.weights)
    return arrays


def _face_entry(face: DesignFace) -> FaceEntry:
    surface = face.surface
    rational = surface.weights is not None
    sense: Literal[-1, 1] = 1 if face.sense > 0 else -1
    return FaceEntry(face.number, face.name, surface.degree_u, surface.degree_v, rational, sense)


def _section_entries(sections: Sequence[Section]) -> tuple[SectionEntry, ...]:
    return tuple(SectionEntry(part.diameter_low, part.diameter_high, part.length) for part in sections)


def _tool_entry(tool: Tool) -> ToolEntry:
    return ToolEntry(
        tool.name,
        tool.r_min,
        tool.r_max,
        tool.length,
        _section_entries(tool.shank),
        _section_entries(tool.holder),
        tool.number,
        tool.spindle_rpm,
        tool.feed_mm_min,
    )


# --- reading --------------------------------------------------------------------------------------------------------


def _damaged(where: str, found: str) -> InputError:
    return InputError(where, found, "an artifact as conflank writes it", "Run the stage that made it again.")


def _wanted(expected: Kind | None) -> str:
    return f"a {expected} file" if expected else f"an artifact ({', '.join(KINDS)})"


def _load_arrays(data: bytes, where: str, expected: Kind | None) -> dict[str, npt.NDArray[Any]]:
    if not data:
        next_step = f"Run conflank {MAKERS[expected]} first." if expected else "Run the stage that makes it first."
        raise InputError(where, "nothing", _wanted(expected), next_step)
    next_step = f"Run conflank {MAKERS[expected]} to make one." if expected else "Run the stage that makes it again."
    if not data.startswith(_ZIP_MAGIC):
        raise InputError(where, "a file of another type", _wanted(expected), next_step)
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (ValueError, OSError, EOFError, KeyError, NotImplementedError, RuntimeError, zipfile.BadZipFile) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(where, f"a truncated or damaged file ({reason})", _wanted(expected), next_step) from None


def _check_schema(arrays: Mapping[str, npt.NDArray[Any]], where: str, expected: Kind | None) -> Kind:
    """Refuse another schema or version by name, before anything else is read."""
    if "meta" not in arrays:
        raise InputError(where, "an NPZ without the document meta", _wanted(expected), "Give a file of conflank's.")
    try:
        head = msgspec.json.decode(arrays["meta"].tobytes(), type=_Schema)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise _damaged(where, f"a document that cannot be read ({error})") from None
    kind = next((kind for kind in KINDS if head.schema == f"conflank/{kind}"), None)
    if kind is None or (expected is not None and kind != expected):
        step = f"Run conflank {MAKERS[expected]} to make one." if expected else "Give a file of conflank's."
        raise InputError(where, f"schema {head.schema!r}", _wanted(expected), step)
    if head.version != SCHEMA_VERSION:
        raise InputError(
            where,
            f"schema {head.schema!r} version {head.version}",
            f"version {SCHEMA_VERSION}",
            f"Run conflank {MAKERS[kind]} of this version again.",
        )
    return kind


def _check_arrays(arrays: Mapping[str, npt.NDArray[Any]], document: Document, where: str) -> None:
    """Refuse arrays that are missing, unknown, not finite, or of a shape that contradicts the document."""
    ranks = {
        "check_vertices": (None, 3),
        "check_triangles": (None, 3),
        "check_face": (None,),
        "motion_offsets": (len(document.sweeps) + 1,),
        "motion_knots": (None,),
        "motion_p": (None, 3),
        "motion_q": (None, 3),
    }
    if document.passes:
        ranks |= {
            "pass_offsets": (len(document.passes) + 1,),
            "pass_tip": (None, 3),
            "pass_axis": (None, 3),
        }
    for face, entry in document.surfaces():
        ranks |= {
            f"{face}_knots_u": (None,),
            f"{face}_knots_v": (None,),
            f"{face}_poles": (None, None, 3),
            f"{face}_loops": (None, 2),
            f"{face}_loop_offsets": (None,),
        }
        if entry.rational:
            ranks[f"{face}_weights"] = (None, None)
    if "face0_coverage_uv" in arrays:
        for index in range(len(document.faces)):
            ranks |= {f"face{index}_coverage_{name}": rank for name, rank in _COVERAGE.items()}
    for name in sorted(ranks.keys() ^ arrays.keys()):
        raise _damaged(where, f"the unknown array {name!r}" if name in arrays else f"no array {name!r}")
    for name, rank in ranks.items():
        array = arrays[name]
        shape = array.shape
        fits = len(shape) == len(rank) and all(b is None or a == b for a, b in zip(shape, rank, strict=True))
        whole = ("offsets", "triangles", "check_face", *(f"coverage_{name}" for name in _COVERAGE_NUMBERS))
        numbers = array.dtype.kind == ("i" if name.endswith(whole) else "f")
        if not (fits and numbers and np.all(np.isfinite(array))):
            raise _damaged(where, f"array {name!r} with shape {shape}, type {array.dtype} or numbers not finite")
    cuts: tuple[SweepEntry | PassEntry, ...] = (*document.sweeps, *document.passes)
    consistent = (
        _steps(arrays["motion_offsets"], len(arrays["motion_p"]), DEGREE + 1)
        and len(arrays["motion_p"]) == len(arrays["motion_q"])
        and len(arrays["motion_knots"]) == len(arrays["motion_p"]) + (DEGREE + 1) * len(document.sweeps)
        and (not document.passes or _passes_consistent(document, arrays))
        and len(arrays["check_face"]) == len(arrays["check_triangles"])
        and _indices(arrays["check_triangles"], len(arrays["check_vertices"]))
        and all(0 <= cut.face < len(document.faces) for cut in cuts)
        and {cut.tool for cut in cuts} <= {tool.name for tool in document.tools}
        and all(_face_consistent(entry, arrays, face) for face, entry in document.surfaces())
        and all(_coverage_consistent(arrays, index, len(document.sweeps)) for index in range(len(document.faces)))
    )
    if not consistent:
        raise _damaged(where, "arrays that contradict each other or the document")


def _steps(offsets: npt.NDArray[Any], total: int, least: int) -> bool:
    return bool(offsets[0] == 0 and offsets[-1] == total and np.all(np.diff(offsets) >= least))


def _passes_consistent(document: Document, arrays: Mapping[str, npt.NDArray[Any]]) -> bool:
    axes = arrays["pass_axis"]
    return (
        document.schema == "conflank/plan"
        and _steps(arrays["pass_offsets"], len(arrays["pass_tip"]), 2)
        and len(axes) == len(arrays["pass_tip"])
        and bool(np.all(np.abs(np.linalg.norm(axes, axis=1) - 1.0) < UNIT_SLACK))
    )


def _indices(triangles: npt.NDArray[Any], count: int) -> bool:
    return bool(np.all(triangles >= 0) and np.all(triangles < count))


def _face_consistent(entry: FaceEntry, arrays: Mapping[str, npt.NDArray[Any]], face: str) -> bool:
    nu, nv, _ = arrays[f"{face}_poles"].shape
    offsets = arrays[f"{face}_loop_offsets"]
    return (
        min(entry.degree_u, entry.degree_v) >= 1
        and len(arrays[f"{face}_knots_u"]) == nu + entry.degree_u + 1
        and len(arrays[f"{face}_knots_v"]) == nv + entry.degree_v + 1
        and (not entry.rational or arrays[f"{face}_weights"].shape == (nu, nv))
        and len(offsets) > 0
        and _steps(offsets, len(arrays[f"{face}_loops"]), 0)
    )


def _coverage_consistent(arrays: Mapping[str, npt.NDArray[Any]], index: int, sweeps: int) -> bool:
    own = [arrays[f"face{index}_coverage_{name}"] for name in _COVERAGE if f"face{index}_coverage_{name}" in arrays]
    if not own:
        return True
    sweep, reason = own[-2:]
    return (
        len({len(array) for array in own}) == 1
        and bool(np.all(sweep >= -1) and np.all(sweep < sweeps))
        and bool(np.all(np.isin(reason, [int(each) for each in Reason])))
    )


def _face(entry: FaceEntry, arrays: Mapping[str, npt.NDArray[Any]], face: str) -> DesignFace:
    surface = BSplineSurface(
        entry.degree_u,
        entry.degree_v,
        arrays[f"{face}_knots_u"],
        arrays[f"{face}_knots_v"],
        arrays[f"{face}_poles"],
        arrays[f"{face}_weights"] if entry.rational else None,
    )
    loops = arrays[f"{face}_loops"]
    cuts = pairwise(arrays[f"{face}_loop_offsets"].tolist())
    return DesignFace(entry.number, entry.name, surface, tuple(loops[a:b].copy() for a, b in cuts), entry.sense)


def _sections(entries: Sequence[SectionEntry]) -> tuple[Section, ...]:
    return tuple(Section(entry.diameter_low, entry.diameter_high, entry.length) for entry in entries)


def _tool(entry: ToolEntry) -> Tool:
    return Tool(
        entry.name,
        entry.r_min,
        entry.r_max,
        entry.length,
        _sections(entry.shank),
        _sections(entry.holder),
        entry.number,
        entry.spindle_rpm,
        entry.feed_mm_min,
    )


def _sweeps(entries: Sequence[SweepEntry], arrays: Mapping[str, npt.NDArray[Any]]) -> tuple[Sweep, ...]:
    sweeps = []
    for k, (entry, (a, b)) in enumerate(zip(entries, pairwise(arrays["motion_offsets"].tolist()), strict=True)):
        knots = arrays["motion_knots"][a + (DEGREE + 1) * k : b + (DEGREE + 1) * (k + 1)].copy()
        motion = Motion(knots, arrays["motion_p"][a:b].copy(), arrays["motion_q"][a:b].copy())
        sweeps.append(Sweep(entry.face, entry.tool, motion, entry.facts))
    return tuple(sweeps)


def _passes(entries: Sequence[PassEntry], arrays: Mapping[str, npt.NDArray[Any]]) -> tuple[Pass, ...]:
    if not entries:
        return ()
    cuts = pairwise(arrays["pass_offsets"].tolist())
    return tuple(
        Pass(entry.face, entry.tool, arrays["pass_tip"][a:b].copy(), arrays["pass_axis"][a:b].copy(), entry.facts)
        for entry, (a, b) in zip(entries, cuts, strict=True)
    )
