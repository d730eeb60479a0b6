"""The job file: what to machine, with which tools, how well, and for which machine.

Every key of the contract is known here, with its default and its limits; unknown keys are errors, so that nothing in a
job file is ever ignored.
"""

from __future__ import annotations

import math
import re
import tomllib
import types
import typing
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
from msgspec import Struct

from conflank_cli.errors import InputError
from conflank_cli.tool import CATALOGUE, Section, Tool


class Limit(NamedTuple):
    """A limit on a value, and how a message words it.

    Not `msgspec.Meta`: with it in a union, msgspec 0.22 crashes in garbage collection (msgspec issue 717).
    """

    holds: Callable[[Any], bool]
    says: str


_POSITIVE = Limit(lambda x: x > 0, "a number > 0")
_NOT_NEGATIVE = Limit(lambda x: x >= 0, "a number >= 0")
# Past 0 and 1 a region runs across the seam of a face that goes all the way round; the reader knows whether it does.
_FRACTION = Limit(lambda x: -1 <= x <= 2, "a number from 0 to 1 (from -1 to 2 across a seam)")
_SHARE = Limit(lambda x: 0 < x <= 1, "a number > 0 and <= 1")
_COUNT = Limit(lambda x: x >= 1, "a whole number >= 1")
_INDEX = Limit(lambda x: x >= 0, "a whole number >= 0")
_SAMPLES = Limit(lambda x: x >= 4, "a whole number >= 4")
_TOOL_NUMBER = Limit(lambda x: 0 <= x <= 32767, "a whole number from 0 to 32767")
_SOME = Limit(lambda x: len(x) > 0, "at least one")
_PROGRAM_NAME = Limit(lambda x: re.fullmatch("[A-Z0-9_-]{1,16}", x) is not None, "1 to 16 characters A-Z 0-9 _ -")

# A program states its tools in comments, one word each, and a control's tool table holds 32 characters.
_TOOL_NAME = Limit(
    lambda x: re.fullmatch("[A-Za-z0-9_.+#-]{1,32}", x) is not None, "1 to 32 characters A-Z a-z 0-9 _ - . + #"
)

# The two tolerances together, mm: what posting may change either way and as much again.
LEAST_BAND = 0.002

Positive = Annotated[float, _POSITIVE]
NotNegative = Annotated[float, _NOT_NEGATIVE]
Fraction = Annotated[float, _FRACTION]
Coverage = Annotated[float, _SHARE]
Count = Annotated[int, _COUNT]
Index = Annotated[int, _INDEX]
Samples = Annotated[int, _SAMPLES]
ProgramName = Annotated[str, _PROGRAM_NAME]
Diameter = Positive | tuple[Positive, Positive]


class Design(Struct, frozen=True, forbid_unknown_fields=True):
    """One design face: its number or name, the side the cutter works on, and the region of it to machine.

    region is (u0, u1, v0, v1) as fractions of the trimmed face's parameter box; on a face that goes all the way round,
    u0 > u1 or v0 > v1 wraps at the seam, and so do fractions past 0 and 1.
    """

    face: Index | str
    side: Literal["outside", "inside"] = "outside"
    region: tuple[Fraction, Fraction, Fraction, Fraction] = (0.0, 1.0, 0.0, 1.0)


class Part(Struct, frozen=True, forbid_unknown_fields=True):
    """The CAD file (relative to the job file), a scale to millimetres on top of the file's own unit, and its faces."""

    file: Annotated[str, _SOME]
    design: Annotated[tuple[Design, ...], _SOME]
    scale: Positive = 1.0
    check_faces: Literal["rest", "none"] | tuple[Index | str, ...] = "rest"


class SectionKeys(Struct, frozen=True, forbid_unknown_fields=True):
    """A section of shank or holder, mm: one diameter, or (low, high) for a cone."""

    diameter: Diameter
    length: Positive

    def section(self) -> Section:
        """The section as the tool model has it."""
        low, high = self.diameter if isinstance(self.diameter, tuple) else (self.diameter, self.diameter)
        return Section(low, high, self.length)


class ToolDefinition(Struct, frozen=True, forbid_unknown_fields=True):
    """A tool of the user's own, mm.

    Without `shank` it has one of radius r_max that sticks out 40 mm, without `holder` the slim shrink-fit holder, both
    as the built-in tools have them; ``holder = []`` means none.
    """

    r_min: Positive
    r_max: Positive
    length: Positive
    shank: SectionKeys | None = None
    holder: tuple[SectionKeys, ...] | None = None
    number: Annotated[int, _TOOL_NUMBER] = 1
    spindle_rpm: Positive = 3000.0
    feed_mm_min: Positive = 1000.0

    def tool(self, name: str) -> Tool:
        """The tool as the stages have it."""
        shank = self.shank.section() if self.shank else Section(2.0 * self.r_max, 2.0 * self.r_max, 40.0)
        holder = CATALOGUE["T1"].holder if self.holder is None else tuple(keys.section() for keys in self.holder)
        return Tool(
            name,
            self.r_min,
            self.r_max,
            self.length,
            (shank,),
            holder,
            self.number,
            self.spindle_rpm,
            self.feed_mm_min,
        )


class Tools(Struct, frozen=True, forbid_unknown_fields=True):
    """The drawer: names to use, and definitions. A definition replaces a built-in tool of the same name."""

    use: Annotated[tuple[str, ...], _SOME]
    define: dict[str, ToolDefinition] = {}


class Tolerance(Struct, frozen=True, forbid_unknown_fields=True):
    """What counts as covered, mm: -overcut <= g <= undercut about the face offset by `allowance`."""

    overcut: NotNegative = 0.010
    undercut: NotNegative = 0.010
    allowance: NotNegative = 0.0


class Detection(Struct, frozen=True, forbid_unknown_fields=True):
    """How densely the face is searched for lines."""

    density: Literal["quick", "normal", "exhaustive"] = "normal"


class Optimization(Struct, frozen=True, forbid_unknown_fields=True):
    """Weights of the objective (the paper's defaults), samples, and what follows.

    mu1 weighs the distance to the surface, mu2 fairness, mu3 proximity, mu4 rigidity, mu5 orthogonality; samples are m
    along the motion and n along the axis.
    """

    mu1: NotNegative = 1.0
    mu2: NotNegative = 0.1
    mu3: NotNegative = 0.001
    mu4: NotNegative = 0.1
    mu5: NotNegative = 0.1
    samples: tuple[Samples, Samples] = (100, 30)
    polish: bool = True
    norm: Literal[2, 4, 8, 16, 32, "max"] = 2
    grow: bool = True


class BallPasses(Struct, frozen=True, forbid_unknown_fields=True):
    """Passes with the ball of the tool where no sweep reaches; scallop height in mm; default tool: the first in use."""

    enabled: bool = False
    scallop: Positive = 0.005
    tool: str | None = None


class Selection(Struct, frozen=True, forbid_unknown_fields=True):
    """How much of the faces to cover, as a fraction of their area, and what to spare on the way."""

    coverage: Coverage = 0.90
    objective: Literal["sweeps", "time"] = "sweeps"
    ball_passes: BallPasses = BallPasses()


class Margin(Struct, frozen=True, forbid_unknown_fields=True):
    """Distances to keep from foreign bodies, mm."""

    cutter: NotNegative = 0.2
    shank: NotNegative = 0.5
    holder: NotNegative = 1.0


class Obstacles(Struct, frozen=True, forbid_unknown_fields=True):
    """Foreign bodies (fixtures) as meshes beside the job file, and the distances to keep from them."""

    meshes: tuple[str, ...] = ()
    margin: Margin = Margin()


class Copies(Struct, frozen=True, forbid_unknown_fields=True):
    """A rotary pattern of the part about an axis through the origin, and the copies to cut, in order (all if unset)."""

    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    count: Count = 1
    only: tuple[Index, ...] | None = None

    @property
    def order(self) -> tuple[int, ...]:
        """Numbers of the copies to cut, in the order they are cut."""
        return tuple(range(self.count)) if self.only is None else self.only


class Setup(Struct, frozen=True, forbid_unknown_fields=True):
    """From the CAD frame to the machine table: XYZ intrinsic rotation in degrees, then translation in mm."""

    rotate_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    translate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    copies: Copies = Copies()


class Machine(Struct, frozen=True, forbid_unknown_fields=True):
    """The machine: a shipped example by name, or a TOML file beside the job file; and how part and tools sit on it.

    definition is the text of that file. It is no key of the job file: `load_job` fills it in, so that a later stage
    needs no other file. zero is the program's datum in machine coordinates with all rotary axes at 0, gauge_length the
    length from tip to spindle nose by tool, mm; without them travels cannot be checked pose by pose.
    """

    name: str = "ac-table"
    file: str | None = None
    definition: str | None = None
    zero: tuple[float, float, float] | None = None
    gauge_length: dict[str, Positive] = {}


class Safe(Struct, frozen=True, forbid_unknown_fields=True):
    """Moves off the part: their distance (mm), and how a cut is entered whose beginning is near the end of another.

    links: "near" goes over with tool centre point control on wherever the way is free and short; "retract" always
    leaves by a full retract.
    """

    clearance: Positive = 5.0
    links: Literal["near", "retract"] = "near"


class Cycle32(Struct, frozen=True, forbid_unknown_fields=True):
    """The control's tolerance cycle: T in mm, TA in degrees (unset: from T and the engaged height)."""

    t: Positive = 0.002
    ta: Positive | None = None


class Foreign(Struct, frozen=True, forbid_unknown_fields=True):
    """What holds for a program from elsewhere that states nothing in its comments.

    Its frame is that of [setup], its preset and its machine are those of the job. reference is the point of the tool
    that it programs, tools the tool of [tools] behind a number or name in the program; without it those of the same
    number or name.
    """

    reference: Literal["tip", "sphere centre"] = "tip"
    tools: dict[str, str] = {}


class Program(Struct, frozen=True, forbid_unknown_fields=True):
    """The program: name on the control, format, style, split, datum, cutting direction, feed, retracts, coolant.

    format is that of an installed post, style one of its styles (None: its first), options are of the post's own.
    datum is the number of a preset, or a shift (x, y, z) of the datum. tool_numbers are numbers on the machine by name
    of tool; empty: those of the tools' definitions. foreign is for judging programs from elsewhere.
    """

    name: ProgramName = "BLADE1"
    format: Annotated[str, _SOME] = "h"
    style: str | None = "tcpm"
    split: Literal["none", "sweep", "tool"] = "none"
    datum: Index | tuple[float, float, float] = 1
    tool_numbers: dict[str, Annotated[int, _TOOL_NUMBER]] = {}
    options: dict[str, str] = {}
    cutting: Literal["climb", "conventional", "both"] = "climb"
    feed: Literal["contact", "tip"] = "contact"
    safe: Safe = Safe()
    coolant: Literal["M7", "M8", "none"] = "M8"
    cycle32: Cycle32 = Cycle32()
    foreign: Foreign | None = None


class Job(Struct, frozen=True, forbid_unknown_fields=True):
    """A whole job, every default filled in. Lengths in mm in the frame of the CAD file."""

    part: Part
    tools: Tools
    tolerance: Tolerance = Tolerance()
    detection: Detection = Detection()
    optimization: Optimization = Optimization()
    selection: Selection = Selection()
    obstacles: Obstacles = Obstacles()
    setup: Setup = Setup()
    machine: Machine = Machine()
    program: Program = Program()

    def resolved_tools(self) -> tuple[Tool, ...]:
        """The tools in use, in the job's order: built in or defined here.

        Raises
        ------
        InputError: a name that is neither, a name given twice, r_min > r_max, or two tools with the same number.
        """
        return _resolve_tools(self, "job")


def load_job(path: str | Path) -> Job:
    """Read and check a job file.

    Raises
    ------
    InputError: the file is missing, is no TOML, has an unknown key, or a value out of its limits.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(
            str(path), f"no readable file ({error.strerror})", "a job file in TOML", "Check the name and the folder."
        ) from None
    return parse_job(data, path.name, path.parent)


def parse_job(data: bytes, where: str, folder: Path) -> Job:
    """Check the text of a job file; `where` names it in messages, `folder` is what its paths are relative to."""
    try:
        tables = tomllib.loads(data.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(
            where, f"text that is no TOML ({error})", "a job file in TOML", "Mend the place it names."
        ) from None
    machine = tables.get("machine")
    if isinstance(machine, dict) and "definition" in machine:
        raise _unknown_key(f"{where}: [machine] definition", "definition", ["name", "file"])
    _check_finite(tables, where, ())
    _check_keys(tables, Job, where, ())
    job = _convert(tables, where)
    _check_limits(job, Job, where, ())
    _check_meaning(job, where, machine if isinstance(machine, dict) else {})
    program = tables.get("program", {})
    if "format" in program and "style" not in program:
        # Each format has styles of its own.
        job = msgspec.structs.replace(job, program=msgspec.structs.replace(job.program, style=None))
    if job.machine.file is not None:
        job = msgspec.structs.replace(job, machine=_embed_machine(job.machine, job.machine.file, where, folder))
    return job


def job_from_builtins(data: object, where: str) -> Job:
    """Rebuild a resolved job from the JSON of an artifact."""
    try:
        job = msgspec.convert(data, Job)
    except msgspec.ValidationError as error:
        raise InputError(
            where, f"a job that this version cannot read ({error})", "the resolved job", "Run the first stage again."
        ) from None
    _check_limits(job, Job, where, ())
    _check_tool_names(job, where)
    return job


def _embed_machine(machine: Machine, name: str, where: str, folder: Path) -> Machine:
    """The machine with the text of its file, so that artifacts stand alone."""
    try:
        # Line ends as they are: the hash of the machine is that of its file.
        text = (folder / name).read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{where}: [machine] file",
            f"{name!r}, which cannot be read ({error})",
            "a machine file in TOML, relative to the job file",
            "Check the name, or name a shipped machine with [machine] name.",
        ) from None
    return msgspec.structs.replace(machine, name=Path(name).stem, definition=text)


# --- keys and types -------------------------------------------------------------------------------------------------

Keys = tuple[str | int, ...]


def _place(keys: Keys) -> str:
    """Where a value stands, as TOML writes it: `[tools.define.MY6] r_min`, `[[part.design]] 0 side`."""
    if not keys:
        return "top level"
    names = list(keys)
    numbers = ""
    while names and isinstance(names[-1], int):
        numbers = f"[{names.pop()}]{numbers}"
    last = f"{names.pop()}{numbers}" if names else numbers
    if not names:
        return f"[{last}]"
    if tuple(names[:2]) == ("part", "design") and len(names) > 2:
        rest = "".join(f"{name}." for name in names[3:])
        return f"[[part.design]] {names[2]} {rest}{last}"
    tables = 3 if names[:2] == ["tools", "define"] else 1
    table = ".".join(str(name) for name in names[:tables])
    rest = "".join(f"[{name}]" if isinstance(name, int) else f".{name}" for name in names[tables:])
    return f"[{table}] {(rest + '.' + last).removeprefix('.')}"


def _unknown_key(where: str, key: str, known: list[str]) -> InputError:
    near = get_close_matches(key, known, n=1, cutoff=0.6)
    hint = f"Did you mean {near[0]!r}?" if near else "Remove it, or look it up in docs/file-formats.md."
    return InputError(where, f"unknown key {key!r}", f"one of {', '.join(sorted(known))}", hint)


def _check_finite(value: object, where: str, keys: Keys) -> None:
    """TOML knows nan and inf, the geometry does not."""
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{where}: {_place(keys)}", f"{value}", "a finite number", "Give a number.")
    if isinstance(value, dict):
        for key, item in value.items():
            _check_finite(item, where, (*keys, key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            _check_finite(item, where, (*keys, index))


def _members(kind: object) -> tuple[Any, ...]:
    """The types a value may have: the members of a union, or the type itself, without their limits."""
    if typing.get_origin(kind) is Annotated:
        kind = typing.get_args(kind)[0]
    if isinstance(kind, types.UnionType) or typing.get_origin(kind) is typing.Union:
        return tuple(member for item in typing.get_args(kind) for member in _members(item))
    return (kind,)


def _check_keys(value: object, kind: object, where: str, keys: Keys) -> None:
    """Refuse keys that no table of the job file has, with the nearest key that it has."""
    for member in _members(kind):
        arguments = typing.get_args(member)
        if isinstance(value, dict) and isinstance(member, type) and issubclass(member, Struct):
            hints = typing.get_type_hints(member, include_extras=True)
            for key, item in value.items():
                if key not in hints:
                    known = [name for name in hints if name != "definition"]
                    raise _unknown_key(f"{where}: {_place((*keys, key))}", str(key), known)
                _check_keys(item, hints[key], where, (*keys, key))
        elif isinstance(value, dict) and typing.get_origin(member) is dict:
            for key, item in value.items():
                _check_keys(item, arguments[1], where, (*keys, key))
        elif isinstance(value, list) and typing.get_origin(member) is tuple and arguments[-1] is Ellipsis:
            for index, item in enumerate(value):
                _check_keys(item, arguments[0], where, (*keys, index))


def _check_limits(value: object, kind: object, where: str, keys: Keys) -> None:
    """Refuse values out of the limits that their types are annotated with."""
    arguments = typing.get_args(kind)
    if typing.get_origin(kind) is Annotated:
        base = arguments[0]
        _check_limits(value, base, where, keys)
        for limit in arguments[1:]:
            if isinstance(value, typing.get_origin(base) or base) and not limit.holds(value):
                raise _out_of_limits(value, limit.says, where, keys)
    elif isinstance(kind, types.UnionType) or typing.get_origin(kind) is typing.Union:
        for member in arguments:
            _check_limits(value, member, where, keys)
    elif isinstance(kind, type) and issubclass(kind, Struct) and isinstance(value, kind):
        for name, hint in typing.get_type_hints(kind, include_extras=True).items():
            _check_limits(getattr(value, name), hint, where, (*keys, name))
    elif typing.get_origin(kind) is tuple and isinstance(value, tuple):
        hints = [arguments[0]] * len(value) if arguments[-1] is Ellipsis else list(arguments)
        for index, (item, hint) in enumerate(zip(value, hints, strict=False)):
            _check_limits(item, hint, where, (*keys, index))
    elif typing.get_origin(kind) is dict and isinstance(value, dict):
        for key, item in value.items():
            _check_limits(item, arguments[1], where, (*keys, key))


def _out_of_limits(value: object, expected: str, where: str, keys: Keys) -> InputError:
    return InputError(
        f"{where}: {_place(keys)}",
        _spell(value),
        expected,
        "Correct the value; docs/file-formats.md lists every key with its limits.",
    )


def _convert(tables: Mapping[str, Any], where: str) -> Job:
    """Tables to the job; a message of the schema becomes one with place, found and expected."""
    # msgspec does not say which key of a table with free names it speaks of, so each is tried by itself first.
    tools = tables.get("tools")
    define = tools.get("define") if isinstance(tools, dict) else None
    if isinstance(define, dict):
        for name, table in define.items():
            _convert_one(table, ToolDefinition, where, ("tools", "define", name))
    machine = tables.get("machine")
    lengths = machine.get("gauge_length") if isinstance(machine, dict) else None
    if isinstance(lengths, dict):
        for name, length in lengths.items():
            _convert_one(length, float, where, ("machine", "gauge_length", name))
    job: Job = _convert_one(tables, Job, where, ())
    return job


def _convert_one(value: Any, kind: Any, where: str, prefix: Keys) -> Any:
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise _schema_error(str(error), value, kind, where, prefix) from None


def _schema_error(message: str, value: Any, kind: Any, where: str, prefix: Keys) -> InputError:
    """Translate `Expected ..., got ... - at `$.a.b[0]``."""
    reason, _, path = message.partition(" - at `$")
    keys: list[str | int] = []
    each = ""
    for token in path.rstrip("`").replace("[", ".[").split("."):
        if token == "[":
            # Some value of a table whose keys are the user's own: which one, msgspec does not say.
            each = " for every key"
            break
        if token.startswith("["):
            keys.append(int(token.strip("[]")))
        elif token:
            keys.append(token)
    if reason.startswith("Object missing required field"):
        missing = reason.split("`")[1]
        place = _place((*prefix, *keys, missing))
        return InputError(f"{where}: {place}", "nothing", f"the key {missing!r}", "Add it: it has no default.")
    found = value
    hint = kind
    for key in keys:
        found = found[key]
        hint = _step(hint, key)
    return _out_of_limits(found, _expectation(reason, hint) + each, where, (*prefix, *keys))


def _step(kind: object, key: str | int) -> Any:
    """The type of an item of a type."""
    for member in _members(kind):
        arguments = typing.get_args(member)
        if isinstance(key, int) and typing.get_origin(member) is tuple:
            return arguments[0] if arguments[-1] is Ellipsis or key >= len(arguments) else arguments[key]
        if isinstance(key, str) and isinstance(member, type) and issubclass(member, Struct):
            return typing.get_type_hints(member, include_extras=True)[key]
    return kind


def _expectation(reason: str, kind: object) -> str:
    """What the schema wants, in words of the job file rather than of Python."""
    words = [
        repr(word)
        for member in _members(kind)
        if typing.get_origin(member) is Literal
        for word in typing.get_args(member)
    ]
    if reason.startswith("Invalid enum value") and words:
        return "one of " + ", ".join(words)
    wanted = reason.removeprefix("Expected ").partition(", got")[0].replace("`", "")
    for old, new in (
        ("object", "table"),
        ("float", "number"),
        ("int", "whole number"),
        ("str", "text"),
        ("bool", "true or false"),
        (" | null", ""),
    ):
        wanted = wanted.replace(old, new)
    return wanted + (" (" + ", ".join(words) + ")" if words else "")


def _spell(value: object) -> str:
    """A value as TOML writes it, short."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "a table"
    text = repr(list(value) if isinstance(value, tuple) else value)
    return text if len(text) <= 60 else text[:57] + "..."


# --- meaning --------------------------------------------------------------------------------------------------------


def _check_meaning(job: Job, where: str, machine: Mapping[str, object]) -> None:
    """Checks between keys."""
    _check_tool_names(job, where)
    tools = _resolve_tools(job, where)
    weights = job.optimization
    if not any((weights.mu1, weights.mu2, weights.mu3, weights.mu4, weights.mu5)):
        raise InputError(
            f"{where}: [optimization] mu1 ... mu5", "all zero", "at least one positive weight", "Leave mu1 at 1."
        )
    tolerance = job.tolerance
    if tolerance.overcut + tolerance.undercut < LEAST_BAND:
        raise InputError(
            f"{where}: [tolerance] overcut, undercut",
            f"{tolerance.overcut:g} and {tolerance.undercut:g} mm",
            f"at least {LEAST_BAND:g} mm together",
            "Posting alone may change the gap by half a micrometre either way; allow more of one of them.",
        )
    for index, design in enumerate(job.part.design):
        u0, u1, v0, v1 = design.region
        if u0 == u1 or v0 == v1:
            raise InputError(
                f"{where}: [[part.design]] {index} region",
                f"{list(design.region)}, which is empty",
                "u0, u1, v0, v1 with u0 != u1 and v0 != v1",
                "Leave it out for the whole face.",
            )
    passes_tool = job.selection.ball_passes.tool
    if passes_tool is not None and passes_tool not in [tool.name for tool in tools]:
        raise InputError(
            f"{where}: [selection] ball_passes.tool",
            repr(passes_tool),
            "a tool of [tools] use: " + ", ".join(job.tools.use),
            "Add it to [tools] use, or name another.",
        )
    for name in job.machine.gauge_length:
        _check_in_use(job, name, f"{where}: [machine] gauge_length.{name}")
    copies = job.setup.copies
    if not any(copies.axis):
        raise InputError(f"{where}: [setup] copies.axis", "[0, 0, 0]", "a direction", "Use [0, 0, 1] for Z.")
    if any(copy >= copies.count for copy in copies.order) or len(set(copies.order)) < len(copies.order):
        raise InputError(
            f"{where}: [setup] copies.only",
            repr(list(copies.order)),
            f"different numbers from 0 to {copies.count - 1}",
            "Correct only or count.",
        )
    if not copies.order:
        raise InputError(f"{where}: [setup] copies.only", "[]", "at least one copy", "Leave it out for all copies.")
    formats = sorted({entry.name for entry in entry_points(group="conflank.postprocessors")})
    if job.program.format not in formats:
        raise InputError(
            f"{where}: [program] format",
            repr(job.program.format),
            "one of " + ", ".join(repr(name) for name in formats),
            "Name one of these, or install the package that brings its post.",
        )
    _check_tool_numbers(job, where)
    for name in () if job.program.foreign is None else job.program.foreign.tools.values():
        _check_in_use(job, name, f"{where}: [program] foreign.tools")
    if "name" in machine and "file" in machine:
        raise InputError(
            f"{where}: [machine]", "both name and file", "one of them", "Remove name to use your own machine file."
        )


def _check_in_use(job: Job, name: str, place: str) -> None:
    if name not in job.tools.use:
        expected = "a tool of [tools] use: " + ", ".join(job.tools.use)
        raise InputError(place, repr(name), expected, "Correct the name.")


def _check_tool_numbers(job: Job, where: str) -> None:
    """Where the machine's tools are listed, every tool in use must be among them, under a number of its own."""
    numbers, place = job.program.tool_numbers, f"{where}: [program] tool_numbers"
    if not numbers:
        return
    for name in job.tools.use:
        if name not in numbers:
            raise InputError(
                place, f"no number for {name}, which [tools] use names", "one for every tool in use", "Add it."
            )
    for name in numbers:
        if name not in job.tools.use:
            raise InputError(
                place,
                repr(name),
                "tools of [tools] use: " + ", ".join(job.tools.use),
                "Remove it, or correct the name.",
            )
    for name, number in numbers.items():
        others = [other for other in numbers if other != name and numbers[other] == number]
        if others:
            raise InputError(
                place, f"number {number} for {name} and {others[0]}", "one number for each tool", "Correct one of them."
            )


def _check_tool_names(job: Job, where: str) -> None:
    """Refuse names that no program can state as they are: its verification would look for another tool."""
    for name in job.tools.define:
        if not _TOOL_NAME.holds(name):
            raise InputError(
                f"{where}: [tools.define.{_spell(name)}]",
                f"the tool name {_spell(name)}",
                _TOOL_NAME.says,
                f"Rename it, for example {_tool_name_like(name)!r}.",
            )


def _tool_name_like(name: str) -> str:
    """A name that may be written, like one that may not."""
    return re.sub("[^A-Za-z0-9_.+#-]+", "_", name).strip("_")[:32] or "TOOL"


def _resolve_tools(job: Job, where: str) -> tuple[Tool, ...]:
    for name, definition in job.tools.define.items():
        if definition.r_min > definition.r_max:
            raise InputError(
                f"{where}: [tools.define.{name}] r_min",
                f"r_min = {definition.r_min:g} greater than r_max = {definition.r_max:g}",
                "r_min <= r_max (equal for a cylinder), in mm",
                "Exchange them: r_min is the radius at the ball's end.",
            )
    drawer = CATALOGUE | {name: definition.tool(name) for name, definition in job.tools.define.items()}
    tools: dict[str, Tool] = {}
    for name in job.tools.use:
        if name not in drawer:
            near = get_close_matches(name, drawer, n=1, cutoff=0.6)
            raise InputError(
                f"{where}: [tools] use",
                f"unknown tool {name!r}",
                "one of " + ", ".join(drawer),
                f"Did you mean {near[0]!r}?" if near else f"Define it in [tools.define.{name}].",
            )
        if name in tools:
            raise InputError(f"{where}: [tools] use", f"{name!r} twice", "each tool once", "Remove one.")
        for other in tools.values():
            if other.number == drawer[name].number:
                raise InputError(
                    f"{where}: [tools] use",
                    f"{other.name} and {name}, both tool number {other.number} on the machine",
                    "a number of its own for each tool",
                    f"Set number in [tools.define.{name}].",
                )
        tools[name] = drawer[name]
    return tuple(tools.values())
