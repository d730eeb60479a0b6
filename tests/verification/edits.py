"""Edits of posted programs: a list of single ones, and systematic ones, each with what the verification must say of it.

`Edit.expect` is "finding" (the machine would do something else: the verification must find something), "none" (the
machine does the same: nothing may be found) or "either" (with the reason why both answers are right).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cache

import numpy as np

from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.machine import machine_of
from conflank_cli.verification.posed import PosedProgram, pose_program
from conflank_cli.verification.reader import read_program
from tests.verification.posted import NOTHING, POINTS, Posted

Blocks = list[str]
Change = Callable[[Blocks], Blocks]

JUDGED = "the motion is judged as it will run"
SAME = "the machine may refuse the block or do the same"
STOPPED = "the control refuses or stops; nothing else moves"


@dataclass(frozen=True, slots=True)
class Edit:
    """One edit of a posted program.

    Attributes
    ----------
    name: what is done.
    change: from the program's blocks, without numbers, to others.
    expect: "finding", "none" or "either".
    why: where either answer is right, why.
    kind, style: format and style of the program that is edited.
    whole: a change of the whole text, with block numbers, after `change`.
    """

    name: str
    change: Change
    expect: str = "finding"
    why: str = ""
    kind: str = "h"
    style: str = "tcpm"
    whole: Callable[[str], str] | None = None

    def text(self, original: Posted) -> str:
        """The edited program."""
        blocks = blocks_of(original.text, self.kind)
        text = numbered(self.change(list(blocks)), self.kind)
        return text if self.whole is None else self.whole(text)


def blocks_of(text: str, kind: str = "h") -> Blocks:
    """The blocks of a posted program without their numbers, and without what ends them."""
    lines = text.removesuffix("\r\n").split("\r\n")
    if kind == "h":
        return [line.partition(" ")[2] if line[:1].isdigit() else line for line in lines]
    if kind == "i":
        return [re.sub(r"^N\d+ ", "", line).removesuffix(" *") for line in lines]
    return lines


def numbered(blocks: Sequence[str], kind: str = "h") -> str:
    """A program of blocks, numbered as the post does."""
    lines: list[str] = []
    if kind == "h":
        number = 0
        for block in blocks:
            lines.append(block if block.startswith("    ") else f"{number} {block}")
            number += not block.startswith("    ")
    elif kind == "i":
        lines = [f"N{10 * number} {block} *" for number, block in enumerate(blocks)]
        for place in (0, -1):
            if blocks[place].startswith("%"):
                lines[place] = f"{'' if place == 0 else 'N99999999 '}{blocks[place]} *"
    else:
        lines = list(blocks)
    return "".join(f"{line}\r\n" for line in lines)


def found(program: Posted, text: str) -> list[str]:
    """Codes of what is found: in the words alone where that is enough, then with the job, then at the part.

    What lies beside the faces is asked last, and only where the cutter goes another way than by the posted program.
    """
    machine = machine_of(program.scene.job.machine)
    read = read_program(text, program.called, machine.axes, machine.harmless)
    if read.findings:
        return [finding.code for finding in read.findings]
    posed = pose_program(text, program.scene, program.called)
    if posed.findings:
        return [finding.code for finding in posed.findings]
    bare = verify_program(text, program.scene.checking(NOTHING), "", POINTS, program.called)
    if bare.findings or not other_poses(program, posed):
        return [finding.code for finding in bare.findings]
    return [finding.code for finding in verify_program(text, program.scene, "", POINTS, program.called).findings]


MOVED = 1e-3, 1e-5
"""Tips (mm) and axes that differ by this much are other poses."""


@cache
def as_posted(program: Posted) -> PosedProgram:
    """The posted program with its poses."""
    return pose_program(program.text, program.scene, program.called)


def other_poses(program: Posted, posed: PosedProgram) -> bool:
    """Whether the cutter goes another way than by the posted program."""
    one = as_posted(program)
    for a, b, least in zip((one.poses.tip, one.poses.axis), (posed.poses.tip, posed.poses.axis), MOVED, strict=True):
        if a.shape != b.shape or float(np.abs(a - b).max()) > least:
            return True
    return not np.array_equal(one.rotary, posed.rotary, equal_nan=True)


def same_reading(program: Posted, posed: PosedProgram) -> bool:
    """Whether a text is read as the posted one is, but for numbers and names of blocks: nothing to judge anew."""
    return _plain(as_posted(program)) == _plain(posed)


def _plain(posed: PosedProgram) -> list[object]:
    """All that a judgement goes by."""
    read, moves = posed.program, posed.program.moves
    columns = [getattr(moves, field.name) for field in fields(moves) if field.name not in ("block", "called")]
    settings = [
        [(setting.before, setting.value) for setting in each] for each in (read.presets, read.tolerances, read.sides)
    ]
    return [
        [column.tobytes() for column in columns],
        posed.poses.tip.tobytes(),
        posed.poses.axis.tobytes(),
        posed.tools,
        read.cuts,
        read.tolerance,
        settings,
        [(event.before, event.what) for event in read.events],
        [(move.before, move.kind, dict(move.words), move.rapid) for move in read.unknown],
        [finding.code for finding in posed.findings],
    ]


# --- making edits ---------------------------------------------------------------------------------------------------


def place(blocks: Blocks, start: str, count: int = 1) -> int:
    """Index of a block by its beginning; the first, or the one that `count` says."""
    return [index for index, block in enumerate(blocks) if block.startswith(start)][count - 1]


def after(start: str, *inserted: str, skip: int = 0, count: int = 1) -> Change:
    """Blocks put in after the one that begins so, `skip` blocks later."""

    def change(blocks: Blocks) -> Blocks:
        at = place(blocks, start, count) + 1 + skip
        return [*blocks[:at], *inserted, *blocks[at:]]

    return change


def before(start: str, *inserted: str, count: int = 1) -> Change:
    """Blocks put in before the one that begins so."""
    return after(start, *inserted, skip=-1, count=count)


def in_cut(*inserted: str) -> Change:
    """Blocks put into the first sweep."""
    return after("; SWEEP 1", *inserted, skip=3)


def at_start(*inserted: str) -> Change:
    """Blocks put in after the tool call, before the first retract."""
    return before("L M140", *inserted)


def before_cut(*inserted: str) -> Change:
    """Blocks put in retracted, before the rotary axes go to their places."""
    return after("L M140", *inserted)


def between(*inserted: str) -> Change:
    """Blocks put in retracted, between two cuts."""
    return after("L M140", *inserted, count=2)


def sub(pattern: str, by: str, count: int = 1) -> Change:
    """The first matches of a pattern (beginnings and ends are those of blocks) changed; at least one must be there."""

    def change(blocks: Blocks) -> Blocks:
        text, times = re.subn(pattern, by, "\n".join(blocks), count=count, flags=re.MULTILINE)
        assert times, pattern
        return text.split("\n")

    return change


def first_feed(feed: str) -> Change:
    """The first feed within the first sweep changed."""
    return sub(r"(^; SWEEP 1\n(?:.*\n)*?.* )F\d+$", rf"\g<1>{feed}")


def drop(start: str, count: int = 1) -> Change:
    """A block left out."""

    def change(blocks: Blocks) -> Blocks:
        at = place(blocks, start, count)
        return [*blocks[:at], *blocks[at + 1 :]]

    return change


def cut_block(change: Callable[[str], str], skip: int = 3) -> Change:
    """A cutting block of the first sweep changed."""

    def changed(blocks: Blocks) -> Blocks:
        at = place(blocks, "; SWEEP 1") + 1 + skip
        new = change(blocks[at])
        assert new != blocks[at]
        return [*blocks[:at], new, *blocks[at + 1 :]]

    return changed


def word(text: str) -> Change:
    """A word put at the end of a cutting block."""
    return cut_block(lambda block: f"{re.sub(' F[0-9]+$', '', block)} {text}")


def same(blocks: Blocks) -> Blocks:
    """No change."""
    return blocks


def both(*changes: Change) -> Change:
    """Changes one after the other."""

    def change(blocks: Blocks) -> Blocks:
        for each in changes:
            blocks = each(blocks)
        return blocks

    return change


def hidden(mark: str) -> Callable[[str], str]:
    """What the approach and the first blocks of a sweep say, put into one comment with a mark that is no line end."""

    def whole(text: str) -> str:
        lines = text.split("\r\n")
        at = next(index for index, line in enumerate(lines) if line.endswith("; SWEEP 1"))
        return "\r\n".join([*lines[:at], mark.join(lines[at : at + 40]), *lines[at + 40 :]])

    return whole


def moved(start: str, by: int) -> Change:
    """A block moved up (negative) or down."""

    def change(blocks: Blocks) -> Blocks:
        at = place(blocks, start)
        block = blocks.pop(at)
        blocks.insert(at + by, block)
        return blocks

    return change


# --- single edits ---------------------------------------------------------------------------------------------------

_SPINDLE = [
    Edit("spindle never started", sub(r" M3$", "")),
    Edit("spindle started the other way", sub(r" M3$", " M4")),
    Edit("spindle turned round before the cut", before("FUNCTION TCPM", "M4")),
    Edit("M14 for M3", sub(r" M3$", " M14")),
    Edit("spindle stopped before the cut", before("FUNCTION TCPM", "M5")),
    Edit("spindle stopped in the cut", in_cut("M5")),
    Edit("spindle stopped within a cutting block", word("M5")),
    Edit("spindle the other way in the cut", in_cut("M4")),
    Edit("spindle started only in the cut", both(sub(r" M3$", ""), in_cut("M3"))),
    Edit("spindle stopped between the cuts", between("M5")),
    Edit("S0", sub(r"S3000", "S0")),
    Edit("no speed", sub(r" S3000", "")),
    Edit("S too high by ten", sub(r"S3000", "S30000")),
    Edit("S+1000", sub(r"S3000", "S4000")),
    Edit("S300", sub(r"S3000", "S300")),
    Edit("speed from a Q parameter that nothing sets", sub(r"S3000", "SQ12")),
    Edit("another speed before the cut", before_cut("TOOL CALL S1500")),
    Edit("another speed in the cut", in_cut("TOOL CALL S1500")),
    Edit("S-3000", sub(r"S3000", "S-3000")),
    Edit("spindle oriented in the cut", in_cut("CYCL DEF 13.0 ORIENTATION", "CYCL DEF 13.1 ANGLE 180")),
    Edit("M19 in the cut", in_cut("M19")),
    Edit("M3 as a block of its own", both(sub(r" M3$", ""), before("FUNCTION TCPM", "M3")), "none"),
    Edit("M03 for M3", sub(r" M3$", " M03"), "none"),
    Edit("M13 for M3, with coolant", sub(r" M3$", " M13"), "none"),
    Edit("the same speed again", before_cut("TOOL CALL S3000"), "either", SAME),
    Edit("M3 again", between("M3"), "none"),
]

_FEED = [
    Edit("a sweep at FMAX", word("FMAX")),
    Edit("all blocks of the program at FMAX", sub(r"(^L X.*?)(?: F\d+)?$", r"\1 FMAX", 0)),
    Edit("F0", word("F0")),
    Edit("F1", word("F1"), "either", "slow, but it moves"),
    Edit("F99999", word("F99999")),
    Edit("F1000000", word("F1000000")),
    Edit("F-500", word("F-500")),
    Edit("F AUTO", word("FAUTO")),
    Edit("F AUTO written apart", word("F AUTO")),
    Edit("FU0.1", word("FU0.1")),
    Edit("FZ0.05", word("FZ0.05")),
    Edit("FT2.5", word("FT2.5")),
    Edit("FMAXT2", word("FMAXT2")),
    Edit("FQ5, never set", word("FQ5")),
    Edit("FQL5, never set", word("FQL5")),
    Edit("FQ5, set to zero", both(before_cut("FN 0: Q5 = +0"), word("FQ5"))),
    Edit(
        "FQ50, set to a sound feed", both(before_cut("FN 0: Q50 = +800"), word("FQ50")), "either", "followed or named"
    ),
    Edit("no feed at all", sub(r" F\d+$", "", 0)),
    Edit("feed ten times", first_feed("F8170")),
    Edit("M136 in the cut", in_cut("M136")),
    Edit("M136 at the start", at_start("M136")),
    Edit("M137", at_start("M137"), "none"),
    Edit("F CONT", sub("F TCP", "F CONT")),
    Edit("M103 F50", in_cut("M103 F50")),
    Edit("M109", in_cut("M109"), "either", "it changes feeds of arcs only"),
    Edit("M128 F0", sub("^M128$", "M128 F0"), style="m128"),
    Edit("M128 F500", sub("^M128$", "M128 F500"), "either", "it caps the movement of the axes", style="m128"),
    Edit("the first positioning at a feed that nothing has set", sub(r"^(L X.*) R0 FMAX$", r"\1 R0")),
    Edit("a feed of three decimals", sub(r"(^; SWEEP 1\n.* F\d+)$", r"\1.000"), "none"),
]

_FRAME = [
    Edit("PLANE RESET TURN in the cut", in_cut("PLANE RESET TURN F1000")),
    Edit("PLANE RESET MOVE in the cut", in_cut("PLANE RESET MOVE SET-UP50 F1000")),
    Edit("PLANE RESET MOVE between the cuts", between("PLANE RESET MOVE SET-UP50 F1000")),
    Edit("PLANE SPATIAL STAY before the cut", before_cut("PLANE SPATIAL SPA+0 SPB+0 SPC+5 STAY")),
    Edit("PLANE SPATIAL TURN before the cut", before_cut("PLANE SPATIAL SPA+10 SPB+20 SPC+0 TURN FMAX")),
    Edit("PLANE SPATIAL in the cut", in_cut("PLANE SPATIAL SPA+0 SPB+1 SPC+0 STAY")),
    Edit("PLANE AXIAL", before_cut("PLANE AXIAL C+5 STAY")),
    Edit("PLANE VECTOR", before_cut("PLANE VECTOR BX+1 BY+0 BZ+0.1 NX-0.1 NY+0 NZ+1 STAY")),
    Edit("PLANE RELATIV", before_cut("PLANE RELATIV SPB+3 STAY")),
    Edit("PLANE without a word", before_cut("PLANE")),
    Edit("cycle 7 before the cut", before_cut("CYCL DEF 7.0 DATUM SHIFT", "CYCL DEF 7.1 X+1")),
    Edit("cycle 7 in the cut", in_cut("CYCL DEF 7.0 DATUM SHIFT", "CYCL DEF 7.1 Z-0.5")),
    Edit("cycle 7 incremental", before_cut("CYCL DEF 7.0 DATUM SHIFT", "CYCL DEF 7.1 IX+2")),
    Edit("cycle 7 from a table", before_cut("CYCL DEF 7.0 DATUM SHIFT", "CYCL DEF 7.1 #5")),
    Edit("cycle 7 from a Q parameter", before_cut("CYCL DEF 7.0 DATUM SHIFT", "CYCL DEF 7.1 X+Q9")),
    Edit("cycle 7 in a rotary axis", before_cut("CYCL DEF 7.0 DATUM SHIFT", "CYCL DEF 7.1 C+5")),
    Edit("cycle 8", before_cut("CYCL DEF 8.0 MIRROR IMAGE", "CYCL DEF 8.1 X")),
    Edit("cycle 8 in the cut", in_cut("CYCL DEF 8.0 MIRROR IMAGE", "CYCL DEF 8.1 Y")),
    Edit("cycle 10", before_cut("CYCL DEF 10.0 ROTATION", "CYCL DEF 10.1 ROT+1")),
    Edit("cycle 10 incremental", before_cut("CYCL DEF 10.0 ROTATION", "CYCL DEF 10.1 IROT+90")),
    Edit("cycle 11", before_cut("CYCL DEF 11.0 SCALING", "CYCL DEF 11.1 SCL 1.01")),
    Edit("cycle 26", before_cut("CYCL DEF 26.0 AXIS-SPEC. SCALING", "CYCL DEF 26.1 X1.05 CCX+0 CCY+0")),
    Edit("cycle 19", before_cut("CYCL DEF 19.0 WORKING PLANE", "CYCL DEF 19.1 A+0 B+2 C+0")),
    Edit("cycle 19 in the cut", in_cut("CYCL DEF 19.0 WORKING PLANE", "CYCL DEF 19.1 A+2 B+0 C+0")),
    Edit("another preset", sub(r"Q339=\+1", "Q339=+2")),
    Edit("another preset before the cut", before_cut("CYCL DEF 247 DATUM SETTING ~", "    Q339=+3 ;DATUM NUMBER")),
    Edit("another preset in the cut", in_cut("CYCL DEF 247 DATUM SETTING ~", "    Q339=+2 ;DATUM NUMBER")),
    Edit("preset of a fraction", sub(r"Q339=\+1", "Q339=+1.5")),
    Edit("preset from a Q parameter", sub(r"Q339=\+1", "Q339=+Q5")),
    Edit("preset without its number", drop("    Q339")),
    Edit("no preset", both(drop("    Q339"), drop("CYCL DEF 247"))),
    Edit("negative preset", sub(r"Q339=\+1", "Q339=-1")),
    Edit("TRANS DATUM", before_cut("TRANS DATUM AXIS X+5")),
    Edit("preset by a newer control's word", before_cut("PRESET SELECT #2")),
    Edit("FN 17 writes system data", before_cut("FN 17: SYSWRITE ID 210 NR3 IDX1 = +5")),
    Edit("the same preset again", before_cut("CYCL DEF 247 DATUM SETTING ~", "    Q339=+1 ;DATUM NUMBER"), "none"),
    Edit("cycle 7 by nothing", before_cut("CYCL DEF 7.0 DATUM SHIFT", "CYCL DEF 7.1 X+0", "CYCL DEF 7.2 Y+0"), "none"),
    Edit("cycle 19 of zeros", before_cut("CYCL DEF 19.0 WORKING PLANE", "CYCL DEF 19.1 A+0 B+0 C+0"), "either", SAME),
    Edit("PLANE RESET STAY again", before_cut("PLANE RESET STAY"), "none"),
]

_TOOL = [
    Edit("another tool", sub("TOOL CALL 1", "TOOL CALL 2")),
    Edit("a stepped tool", sub("TOOL CALL 1", "TOOL CALL 1.2")),
    Edit("tool from a Q parameter", sub("TOOL CALL 1", "TOOL CALL Q5")),
    Edit("tool from a string parameter", sub("TOOL CALL 1", "TOOL CALL QS5")),
    Edit("another tool by name", sub("TOOL CALL 1", 'TOOL CALL "T9"')),
    Edit("the tool by name", sub("TOOL CALL 1", 'TOOL CALL "T1"'), "either", "the name may not be the machine's"),
    Edit("tool without an axis", sub("TOOL CALL 1 Z", "TOOL CALL 1")),
    *(Edit(f"tool axis {axis}", sub("TOOL CALL 1 Z", f"TOOL CALL 1 {axis}")) for axis in "XYUVW"),
    *(
        Edit(f"TOOL CALL with {delta}", sub("S3000", f"S3000 {delta}"))
        for delta in ("DL+0.1", "DL-0.02", "DLQ5", "DL+Q5", "DR+0.1", "DR-Q6", "DR2+0.1", "DR2:+0.1", "DL")
    ),
    Edit("deltas of nothing", sub("S3000", "S3000 DL+0 DR+0"), "either", SAME),
    Edit("delta given later", before_cut("TOOL CALL DL+0.2")),
    Edit("no tool", drop("TOOL CALL")),
    Edit("tool called in the cut", in_cut("TOOL CALL 1 Z S3000")),
    Edit("another tool called in the cut", in_cut("TOOL CALL 2 Z S3000")),
    Edit("another tool between the cuts", between("TOOL CALL 3 Z S3000")),
    Edit("M6 in the cut", in_cut("M6")),
    Edit("tool 0 between the cuts", between("TOOL CALL 0 Z")),
    Edit("tool defined in the program", before("TOOL CALL", "TOOL DEF 1 L+10 R+1")),
    Edit("the next tool made ready", between("TOOL DEF 2"), "none"),
    Edit("TOOL CALL 01", sub("TOOL CALL 1", "TOOL CALL 01"), "either", SAME),
]

_MOTION = [
    Edit("RL while TCPM is off", sub(r"R0 FMAX M3$", "RL FMAX M3")),
    Edit("RR in the retract", sub(r"^L M140 MB MAX$", "L RR M140 MB MAX")),
    Edit("DR with RL", both(sub("S3000", "S3000 DR+0.05"), word("RL"))),
    Edit("M91 in the cut", in_cut("L Z-50 FMAX M91")),
    Edit("M91 on a cutting block", word("M91")),
    Edit("M92 on a cutting block", word("M92")),
    Edit("M91 down between the cuts", between("L Z-500 R0 FMAX M91")),
    Edit("M91 aside between the cuts", between("L X+100 Y+100 R0 FMAX M91"), "either", "retracted, it stays above"),
    Edit("M92 between the cuts", between("L Z+0 R0 FMAX M92"), "either", "up or down: the machine must be known"),
    Edit("M140 MB5 for the first retract", sub("MB MAX", "MB5")),
    Edit("M140 MB-20 after the cut", sub("^L M140 MB MAX\nL A", "L M140 MB-20\nL A")),
    Edit("M140 MB5 between the cuts", sub("^L M140 MB MAX\nL A", "L M140 MB5\nL A")),
    Edit(
        "M140 without MB",
        sub("^L M140 MB MAX\nL A", "L M140\nL A"),
        "either",
        "the control asks for MB, or takes its limit",
    ),
    Edit("no retract between the cuts", drop("L M140", 2)),
    Edit("no rotary words before the second cut", drop("L A", 2), "either", JUDGED),
    Edit("rotary axes turned while the tool is at the part", in_cut("L C+90 FMAX")),
    Edit("TCPM never on", drop("FUNCTION TCPM")),
    Edit("TCPM not on for the second cut", drop("FUNCTION TCPM", 2)),
    Edit("TCPM off in the cut", in_cut("FUNCTION RESET TCPM")),
    Edit("TCPM off within the approach", before("; SWEEP 1", "FUNCTION RESET TCPM")),
    Edit("M129 in the cut", in_cut("M129")),
    Edit("retract while TCPM is still on", drop("FUNCTION RESET", 2), "either", JUDGED),
    Edit("REFPNT", sub("PATHCTRL VECTOR", "PATHCTRL VECTOR REFPNT CENTER-CENTER")),
    Edit("AXIS SPAT", sub("AXIS POS", "AXIS SPAT")),
    Edit("PATHCTRL AXIS", sub("PATHCTRL VECTOR", "PATHCTRL AXIS"), "none"),
    Edit("M128 for FUNCTION TCPM", sub("^FUNCTION TCPM.*", "M128"), "none"),
    Edit("FUNCTION TCPM cut off", sub("^FUNCTION TCPM.*", "FUNCTION TCPM F TCP AXIS POS")),
    Edit("FUNCTION TCPM with a word too many", sub("PATHCTRL VECTOR", "PATHCTRL VECTOR FEED")),
    Edit("FUNCTION TCPM misspelt", sub("^FUNCTION TCPM", "FUNCTION TCMP")),
    Edit("FUNCTION MODE TURN", before_cut("FUNCTION MODE TURN")),
    Edit("FUNCTION FEED DWELL", before_cut("FUNCTION FEED DWELL D-TIME0.5 F-TIME5")),
    Edit("FUNCTION PARAXCOMP", before_cut("FUNCTION PARAXCOMP MOVE W")),
    Edit("M127 for M126", sub("^M126$", "M127"), "either", JUDGED),
    Edit("M94 in the cut", in_cut("M94"), "either", "it changes what is shown"),
    Edit("M116", before_cut("M116"), "either", "no block turns rotary axes alone at feed"),
    Edit("an increment", cut_block(lambda block: block.replace("X+", "IX+"))),
    Edit("a rotary increment", cut_block(lambda block: block.replace(" C", " IC"))),
    Edit("a coordinate twice", cut_block(lambda block: block.replace(" Y", " X+1 Y"))),
    Edit("the same coordinate twice", word("Y+0")),
    Edit("two feeds", word("F800 F900")),
    Edit("coordinate from a Q parameter", cut_block(lambda block: re.sub(r"Y\S+", "Y+Q7", block))),
    Edit("coordinate out of range", cut_block(lambda b: re.sub(r"X\S+", "X+100000", b))),
    Edit("coordinate of 300 digits", cut_block(lambda block: re.sub(r"X\S+", "X+" + "9" * 300, block))),
    Edit("C+280000000000", cut_block(lambda block: re.sub(r"C\S+", "C+280000000000", block))),
    Edit("A out of its range", cut_block(lambda block: re.sub(r"A\S+", "A-150.0000", block))),
    Edit("A the other way", cut_block(lambda block: block.replace("A-", "A+"))),
    Edit(
        "a whole turn of C in the cut", cut_block(lambda block: re.sub(r"C\S+", "C+455.0000", block)), "either", JUDGED
    ),
    Edit("an axis that the machine has not", cut_block(lambda block: block.replace(" A", " B"))),
    Edit("a sixth axis", word("B+5")),
    Edit("a W word", word("W+10")),
    Edit("a tool vector without LN", word("TX+0 TY+0 TZ+1")),
    Edit("LN without TZ", sub(r"(?<=TY)(\S+) TZ\S+", r"\1", 1), style="ln"),
    Edit("LN with a long vector", sub(r"TZ\+0\.", "TZ+1.", 1), style="ln"),
    Edit("LN with normals", sub(r" TX", " NX+1 NY+0 NZ+0 TX", 1), "either", "deltas are nothing", style="ln"),
    Edit("LN with a component changed", sub(r"(; SWEEP 1\nLN .*TX)[+-]\S+", r"\1+0.7000000"), style="ln"),
    Edit("circle without a centre", in_cut("C X+10 Y+10 DR+")),
    Edit("arc CR in the cut", in_cut("CR X+3.5 Y-4 R+20 DR+")),
    Edit("arc CT in the cut", in_cut("CT X+3.5 Y-4")),
    Edit("polar line without a pole", in_cut("LP PR+5 PA+30")),
    Edit("chamfer in the cut", in_cut("CHF 2")),
    Edit("rounding in the cut", in_cut("RND R2"), "either", JUDGED),
    Edit("APPR in the cut", in_cut("APPR LT X+3.4 Y-4 LEN5 RL F500")),
    Edit("spline", in_cut("SPL X+3 Y-4 Z+40")),
    Edit("cycle called", in_cut("CYCL CALL")),
    Edit("cycle called at a place", word("M99")),
    Edit("drilling cycle", before_cut("CYCL DEF 200 DRILLING Q200=2 Q201=-20")),
    Edit("touch probe", before_cut("TCH PROBE 0.0 REF. PLANE Q5 X-")),
    Edit("handwheel superimposed", in_cut("M118 X1 Y1 Z1")),
    Edit("sequence of an unknown word", in_cut("L X+3.47 Y-4 Z+39.95 BIG")),
    Edit("a block that is not understood", in_cut("HELLO")),
    Edit("words in another order", cut_block(lambda b: " ".join(["L", *reversed(b.split()[1:])])), "none"),
    Edit("a pose of another line", cut_block(lambda block: re.sub(r"X\S+ Y\S+", "X+9.0000 Y-4.0000", block))),
    *(
        Edit(f"M{function} in the cut", in_cut(f"M{function}"))
        for function in (10, 89, 97, 98, 99, 101, 104, 114, 115, 120, 124, 138, 141, 143, 144, 150, 200, 400)
    ),
    *(
        Edit(f"M{function} in the cut", in_cut(f"M{function}"), "either", "the path stays")
        for function in (90, 112, 134, 145, 148)
    ),
    Edit("M107", in_cut("M107"), "either", "it suppresses a message"),
]

_STOPS = [
    Edit("M0 in the cut", in_cut("M0")),
    Edit("M00 within a cutting block", word("M00")),
    Edit("M1 in the cut", in_cut("M1")),
    Edit("STOP in the cut", in_cut("STOP")),
    Edit("STOP M8 in the cut", in_cut("STOP M8")),
    Edit("dwell in the cut", in_cut("CYCL DEF 9.0 DWELL TIME", "CYCL DEF 9.1 DWELL 5")),
    Edit("M2 in the cut", in_cut("M2")),
    Edit("M30 in the cut", in_cut("M30")),
    Edit("END PGM in the cut", in_cut("END PGM BLADE1 MM")),
    Edit("FN 14 in the cut", in_cut("FN 14: ERROR=1000")),
    Edit("FN 19 in the cut", in_cut("FN 19: PLC=+10/+Q3")),
    Edit("FN 20 in the cut", in_cut("FN 20: WAIT FOR M4095==1")),
    Edit("M0 between the cuts", between("M0"), "either", "M0 stops the spindle; M3 may be asked for again"),
    Edit("dwell between the cuts", between("CYCL DEF 9.0 DWELL TIME", "CYCL DEF 9.1 DWELL 5"), "none"),
]

_TOLERANCE = [
    Edit("cycle 32 of T5", sub("T0.002", "T5")),
    Edit("cycle 32 of T0.1", sub("T0.002", "T0.1")),
    Edit("cycle 32 of TA10", sub("TA0.0044", "TA10")),
    Edit("cycle 32 of TA0.5", sub("TA0.0044", "TA0.5")),
    Edit("no TA", sub(" TA0.0044", "")),
    Edit("no cycle 32", both(*(drop("CYCL DEF 32.") for _ in range(3)))),
    Edit("cycle 32 without its last line", drop("CYCL DEF 32.2")),
    Edit("cycle 32 without its values", both(drop("CYCL DEF 32.1"), drop("CYCL DEF 32.2"))),
    Edit("cycle 32 reset in the cut", in_cut("CYCL DEF 32.0 TOLERANCE", "CYCL DEF 32.1")),
    Edit("cycle 32 reset before the cut", before_cut("CYCL DEF 32.0 TOLERANCE", "CYCL DEF 32.1")),
    Edit(
        "cycle 32 coarse in the cut",
        in_cut("CYCL DEF 32.0 TOLERANCE", "CYCL DEF 32.1 T1", "CYCL DEF 32.2 HSC-MODE:0 TA3"),
    ),
    Edit("cycle 32 from a Q parameter", sub("T0.002", "TQ4")),
    Edit("cycle 32 for roughing", sub("HSC-MODE:0", "HSC-MODE:1"), "either", "T and TA hold in both modes"),
    Edit("no reset of cycle 32 at the end", both(drop("CYCL DEF 32.0", 2), drop("CYCL DEF 32.1", 2)), "none"),
    Edit("CYCL DEF 32.0 shortened", sub("32.0 TOLERANCE", "32.0"), "either", SAME),
]

_COOLANT = [
    Edit("no coolant", drop("M8")),
    Edit("mist for flood", sub("^M8$", "M7")),
    Edit("coolant off in the cut", in_cut("M9")),
    Edit("coolant off before the cut", before("; SWEEP 1", "M9")),
    Edit("coolant off between the cuts", between("M9")),
    Edit("coolant only in the cut", both(drop("M8"), in_cut("M8"))),
    Edit("coolant before the spindle", moved("M8", -5), "none"),
    Edit("M08", sub("^M8$", "M08"), "none"),
    Edit("M8 again", between("M8"), "none"),
]

_HEADER = [
    Edit("another machine", sub("MACHINE ac-table", "MACHINE head-head")),
    Edit("another machine in a second line", after("; MACHINE", "; MACHINE bc-table")),
    Edit("another part", sub("PART block", "PART blade")),
    Edit("other faces", sub("FACE 4,5", "FACE 7"), "either", "what is cut is judged on the job's faces"),
    Edit("another tool's name", sub("TOOL 1 T1 R_MIN", "TOOL 1 T3 R_MIN")),
    Edit("another tool's number", sub("; TOOL 1", "; TOOL 2")),
    Edit("another radius", sub("R_MIN 1.5", "R_MIN 1.6")),
    Edit("another length", sub("LENGTH 24", "LENGTH 30")),
    Edit("the tool stated twice, differently", after("; TOOL", "; TOOL 1 T1 R_MIN 1.7 R_MAX 3 LENGTH 24")),
    Edit("another frame", sub("TRANSLATE 5", "TRANSLATE 6")),
    Edit("another turn of the frame", sub("ROTATE 0 -25", "ROTATE 0 25")),
    Edit("FRAME CAD", sub("^; FRAME.*", "; FRAME CAD")),
    Edit("a second frame", after("; FRAME", "; FRAME CAD")),
    Edit("a second frame at the end", before("M30", "; FRAME CAD")),
    Edit("another reference point", sub("REFERENCE TIP", "REFERENCE SPHERE CENTRE")),
    Edit("two reference points", after("; REFERENCE", "; REFERENCE SPHERE CENTRE")),
    Edit("an unknown reference point", sub("REFERENCE TIP", "REFERENCE NOSE")),
    Edit("axes that are not the machine's", after("; FRAME", "; ROTARY C 0 0 -1", "; ROTARY A 1 0 0")),
    Edit("no tool in the header", drop("; TOOL")),
    Edit("no frame", drop("; FRAME")),
    Edit("no reference point", drop("; REFERENCE")),
    Edit("another style", sub("STYLE tcpm", "STYLE m128"), "either", "the text says itself what it does"),
    Edit("another version", sub("CONFLANK .*", "CONFLANK 9"), "none"),
]

_FLOW = [
    Edit("a block skipped", cut_block(lambda block: f"/ {block}")),
    Edit("M8 skipped", sub("^M8$", "/ M8")),
    Edit("a label that is missing", in_cut("CALL LBL 99")),
    Edit("a label twice", in_cut("LBL 5", "LBL 5")),
    Edit("a label that nothing calls", in_cut("LBL 5"), "none"),
    Edit("a repetition without end", in_cut("LBL 5", "CALL LBL 5 REP 99999999")),
    Edit("a called label without its end", both(before("M30", "CALL LBL 7"), after("M30", "LBL 7", "M8"))),
    Edit(
        "a part repeated",
        both(before("; SWEEP 1", "LBL 5"), before("; RETRACT 1", "CALL LBL 5 REP 1")),
        "either",
        JUDGED,
    ),
    Edit("a program that is not there", in_cut("CALL PGM NOWHERE")),
    Edit("a program that is not there, at the end", before("M30", "CALL PGM NOWHERE")),
    Edit("a program in a circle", before("M30", "CALL PGM BLADE1")),
    Edit(
        "a jump over the sweep",
        both(before("; SWEEP 1", "FN 9: IF +1 EQU +1 GOTO LBL 5"), before("; RETRACT 1", "LBL 5")),
    ),
    Edit(
        "a jump over the start of the spindle",
        both(before("L A", "FN 9: IF +0 EQU +0 GOTO LBL 5"), before("FUNCTION TCPM", "LBL 5")),
    ),
    Edit(
        "a jump by a Q parameter that nothing sets",
        both(before("; SWEEP 1", "FN 9: IF +Q5 EQU +1 GOTO LBL 5"), before("; RETRACT 1", "LBL 5")),
    ),
    Edit("a jump to nowhere", in_cut("FN 9: IF +1 EQU +1 GOTO LBL 9")),
    Edit(
        "a jump never taken",
        both(in_cut("FN 9: IF +1 EQU +2 GOTO LBL 5"), before("; RETRACT 1", "LBL 5")),
        "either",
        "followed or named",
    ),
    Edit("a Q parameter set and not used", before_cut("FN 0: Q5 = +3"), "either", "followed or named"),
    Edit("SEL PGM", before_cut('SEL PGM "OTHER.H"'), "finding"),
    Edit("SEL TABLE", before_cut('SEL TABLE "OTHER.D"'), "finding"),
]


def _renamed(text: str) -> str:
    return re.sub(r"(?<=END PGM )\S+", "OTHER", text)


def _upper(text: str) -> str:
    return text.lower().replace("begin pgm blade1 mm", "BEGIN PGM BLADE1 MM")


_TEXT = [
    Edit("inches", sub("(BEGIN PGM .*) MM", r"\1 INCH")),
    *(
        Edit(f"blocks hidden behind {name}", same, whole=hidden(mark))
        for name, mark in (
            ("U+2028", "\u2028"),
            ("U+2029", "\u2029"),
            ("U+0085", "\x85"),
            ("a vertical tab", "\v"),
            ("a form feed", "\f"),
            ("a file separator", "\x1c"),
            ("a group separator", "\x1d"),
            ("a record separator", "\x1e"),
            ("NUL", "\0"),
            ("carriage return alone", "\r"),
        )
    ),
    Edit("NUL within a word", cut_block(lambda block: block.replace("+3", "+3\0"))),
    Edit("a letter that is no ASCII in a comment", sub("; CONFLANK", "; M\xdcLLER")),
    Edit("a Cyrillic letter for an axis", cut_block(lambda block: block.replace("X", "\u0425"))),
    Edit("digits of another script", cut_block(lambda block: block.replace("+3", "+\u0663"))),
    Edit("a no-break space", cut_block(lambda block: block.replace(" Y", "\xa0Y"))),
    Edit("text after the end", same, whole=lambda text: text + "L X+0 Y+0 Z+0 FMAX\r\n"),
    Edit("rubbish after the end", same, whole=lambda text: text + "and so on\r\n"),
    Edit("two programs", same, whole=lambda text: text + text),
    Edit("two programs, the other first", same, whole=lambda text: "0 BEGIN PGM A MM\r\n1 END PGM A MM\r\n" + text),
    Edit("the end missing", same, whole=lambda text: text[: text.rindex("END PGM")].rpartition("\r\n")[0] + "\r\n"),
    Edit("the end of another program", same, whole=_renamed),
    Edit("the end in inches", sub("(END PGM .*) MM", r"\1 INCH")),
    Edit("the beginning missing", drop("BEGIN PGM")),
    Edit("cut off in the middle", same, whole=lambda text: text[: len(text) // 2]),
    Edit(
        "a comment before the beginning", before("BEGIN PGM", "; FIRST"), "either", "the control wants BEGIN PGM first"
    ),
    Edit("a wrong unit at the beginning", sub("(BEGIN PGM .*) MM", r"\1")),
    Edit("no block numbers", same, "none", whole=lambda text: re.sub(r"(?m)^\d+ ", "", text)),
    Edit("block numbers by ten", same, "none", whole=lambda text: re.sub(r"(?m)^(\d+) ", r"\g<1>0 ", text)),
    Edit("small letters", same, "either", "the control writes capitals", whole=_upper),
    Edit("LF alone", same, "none", whole=lambda text: text.replace("\r\n", "\n")),
    Edit("empty lines at the end", same, "none", whole=lambda text: text + "\r\n\r\n"),
    Edit("more spaces", sub(" Y", "   Y", 0), "none"),
    Edit("leading zeros", sub(r"X\+(\d\.)", r"X+00\1", 0), "none"),
    Edit("decimal commas", sub(r"(?<=[A-Z][+-]\d)\.(?=\d)", ",", 0), "none"),
    Edit("comments", after("; SWEEP 1", "; ALL IS WELL", "* - FINISHING"), "none"),
    Edit("a comment behind a block", word("; HERE"), "none"),
    Edit("another blank", sub(r"(BLK FORM 0.2 X\S+ Y\S+) Z\S+", r"\1 Z+90"), "none"),
    Edit("no blank", both(drop("BLK FORM"), drop("BLK FORM")), "none"),
    Edit("other labels of the list of contents", before("; SWEEP 1", "* - SWEEP 1"), "none"),
    Edit("signs left out", sub(r"(?<= [XYZC])\+", "", 0), "none"),
    Edit("zeros left out", sub(r"(\.\d*[1-9])0+(?= |$)", r"\1", 0), "none"),
]

_ISO = [
    Edit(name, change, expect, why, "i", "m128")
    for name, change, expect, why in (
        ("spindle never started", sub(" M3$", ""), "finding", ""),
        ("spindle the other way", sub(" M3$", " M4"), "finding", ""),
        ("S0", sub("S3000", "S0"), "finding", ""),
        ("S+1000", sub("S3000", "S4000"), "finding", ""),
        ("a sweep at rapid", sub("^(; SWEEP 1\n(?:G01.*\n){3})G01", r"\1G00"), "finding", ""),
        ("F0", first_feed("F0"), "finding", ""),
        ("F99999", first_feed("F99999"), "finding", ""),
        ("feed from Q", first_feed("FQ5"), "finding", ""),
        ("G94 and G95", after("; SWEEP 1", "G95 F0.1"), "finding", ""),
        ("a shift", after("; SWEEP 1", "G54 X+1"), "finding", ""),
        ("a shift before the cut", before("M128", "G54 Z+0.5"), "finding", ""),
        ("a shift by nothing", before("M128", "G54 X+0 Y+0 Z+0"), "none", ""),
        ("a shift from a table", before("M128", "G53 P01 5"), "finding", ""),
        ("G247 of another preset", sub(r"Q339=\+1", "Q339=+2"), "finding", ""),
        ("mirror", before("M128", "G28 X"), "finding", ""),
        ("rotation", before("M128", "G73 G90 H+1"), "finding", ""),
        ("scaling", before("M128", "G72 F1.01"), "finding", ""),
        ("tilted plane", before("M128", "G80 A+0 B+2 C+0"), "finding", ""),
        ("another tool", sub("^T1 ", "T2 "), "finding", ""),
        ("a stepped tool", sub("^T1 ", "T1.2 "), "finding", ""),
        ("tool from Q", sub("^T1 ", "TQ5 "), "finding", ""),
        ("length delta", sub("S3000", "S3000 DL+0.1"), "finding", ""),
        ("tool axis Y", sub("G17 S", "G18 S"), "finding", ""),
        ("increments", after("; SWEEP 1", "G91"), "finding", ""),
        ("M128 missing", drop("M128"), "finding", ""),
        ("M129 in the cut", after("; SWEEP 1", "M129"), "finding", ""),
        ("coolant off", drop("M8"), "finding", ""),
        ("dwell in the cut", after("; SWEEP 1", "G04 F5", skip=3), "finding", ""),
        ("G38 in the cut", after("; SWEEP 1", "G38", skip=3), "finding", ""),
        ("M0 in the cut", after("; SWEEP 1", "M0", skip=3), "finding", ""),
        ("G36 in the cut", after("; SWEEP 1", "G36 S0", skip=3), "finding", ""),
        ("tolerance", sub("T0.002", "T5"), "finding", ""),
        ("tolerance of rotary axes", sub("P02 [0-9.]+", "P02 10"), "finding", ""),
        ("no tolerance", drop("G62"), "finding", ""),
        ("inches", sub("G71", "G70"), "finding", ""),
        ("G70 in the program", before("M128", "G70"), "finding", ""),
        ("rounding", after("; SWEEP 1", "G25 R2", skip=2), "either", JUDGED),
        ("circle", after("; SWEEP 1", "G02 X+3.5 Y-4 R+20"), "finding", ""),
        ("circle modal", sub("^(; SWEEP 1\n)G01 (.*\n)G01", r"\1G02 \2"), "finding", ""),
        ("drilling cycle", before("M128", "G83 P01 -2"), "finding", ""),
        ("G79", after("; SWEEP 1", "G79"), "finding", ""),
        ("a code that nobody knows", after("; SWEEP 1", "G77"), "finding", ""),
        ("subprogram that is not there", after("; SWEEP 1", "L9,0"), "finding", ""),
        ("G98 twice", after("; SWEEP 1", "G98 L5", "G98 L5"), "finding", ""),
        ("Q parameter not set", sub("^(; SWEEP 1\nG01) X\\S+", r"\1 X+Q5"), "finding", ""),
        ("retract that is none", sub("M140 MB MAX", "M140 MB3"), "finding", ""),
        ("last % missing", lambda blocks: blocks[:-1], "finding", ""),
        ("G1 for G01", sub("G01", "G1", 0), "none", ""),
        ("G40 again", after("M128", "G40"), "none", ""),
        ("G90 again", after("; SWEEP 1", "G90"), "none", ""),
    )
]

_APT = [
    Edit(name, change, expect, why, "apt", "multax")
    for name, change, expect, why in (
        ("spindle never started", drop("SPINDL/3000"), "finding", ""),
        ("spindle the other way", sub("CLW", "CCLW"), "finding", ""),
        ("no speed", sub("SPINDL/3000,RPM,CLW", "SPINDL/CLW"), "finding", ""),
        ("speed of nothing", sub("SPINDL/3000", "SPINDL/0"), "finding", ""),
        ("speed + 1000", sub("SPINDL/3000", "SPINDL/4000"), "finding", ""),
        ("spindle off in the cut", after("PPRINT/SWEEP 1", "SPINDL/OFF", skip=8), "finding", ""),
        ("surface speed", sub("RPM,CLW", "SMM,CLW"), "finding", ""),
        ("rapid in the cut", after("PPRINT/SWEEP 1", "RAPID", skip=8), "finding", ""),
        ("rapid before a feed", after("PPRINT/SWEEP 1", "RAPID"), "finding", ""),
        ("feed of nothing", after("PPRINT/SWEEP 1", "FEDRAT/0,MMPM"), "finding", ""),
        ("feed too fast", sub(r"(^PPRINT/SWEEP 1\nFEDRAT/)\d+", r"\g<1>99999"), "finding", ""),
        ("feed a turn", after("PPRINT/SWEEP 1", "FEDRAT/0.1,MMPR"), "finding", ""),
        ("inverse time", after("PPRINT/SWEEP 1", "FEDRAT/INVERS,5"), "finding", ""),
        ("no feed", lambda blocks: [block for block in blocks if not block.startswith("FEDRAT")], "finding", ""),
        ("inches", sub("UNITS/MM", "UNITS/INCHES"), "finding", ""),
        ("no units", drop("UNITS"), "finding", ""),
        ("units again, others", after("PPRINT/SWEEP 1", "UNITS/INCHES"), "finding", ""),
        ("another tool", sub("LOADTL/1", "LOADTL/2"), "finding", ""),
        ("no tool", drop("LOADTL"), "finding", ""),
        (
            "tool with another length",
            sub("LOADTL/1", "LOADTL/1,LENGTH,50"),
            "either",
            "the length is the machine's matter",
        ),
        ("tool in the cut", after("PPRINT/SWEEP 1", "LOADTL/1"), "finding", ""),
        ("compensation", after("PPRINT/SWEEP 1", "CUTCOM/LEFT"), "finding", ""),
        ("shifted", after("PPRINT/SWEEP 1", "TRANS/1,0,0"), "finding", ""),
        ("origin", before("RETRCT", "ORIGIN/0,0,1"), "finding", ""),
        ("turned", after("PPRINT/SWEEP 1", "ROTATE/AAXIS,10"), "finding", ""),
        ("copied", after("PPRINT/SWEEP 1", "COPY/1,TRANSL,1,0,0,2"), "finding", ""),
        ("a matrix", before("RETRCT", "TRACUT/1,0,0,5,0,1,0,0,0,0,1,0"), "finding", ""),
        ("coolant missing", drop("COOLNT/FLOOD"), "finding", ""),
        ("coolant off in the cut", after("PPRINT/SWEEP 1", "COOLNT/OFF", skip=8), "finding", ""),
        ("mist", sub("COOLNT/FLOOD", "COOLNT/MIST"), "finding", ""),
        ("stop in the cut", after("PPRINT/SWEEP 1", "STOP", skip=8), "finding", ""),
        ("optional stop in the cut", after("PPRINT/SWEEP 1", "OPSTOP", skip=8), "finding", ""),
        ("dwell in the cut", after("PPRINT/SWEEP 1", "DELAY/5", skip=8), "finding", ""),
        ("text inserted", after("PPRINT/SWEEP 1", "INSERT/M05"), "finding", ""),
        ("auxiliary function", after("PPRINT/SWEEP 1", "AUXFUN/5"), "finding", ""),
        ("a cycle", after("PPRINT/SWEEP 1", "CYCLE/DRILL,5,MMPM,100"), "finding", ""),
        ("a circle", after("PPRINT/SWEEP 1", "CIRCLE/0,0,0,0,0,1,5"), "finding", ""),
        ("axes fixed", after("PPRINT/SWEEP 1", "MULTAX/OFF"), "either", "every GOTO states its axis"),
        ("no FINI", drop("FINI"), "finding", ""),
        ("text after FINI", after("FINI", "GOTO/0,0,0"), "finding", ""),
        ("an unknown word", after("PPRINT/SWEEP 1", "WIGGLE/3"), "finding", ""),
        ("GOHOME in the cut", after("PPRINT/SWEEP 1", "GOHOME"), "finding", ""),
        ("another machine", sub("MACHINE ac-table", "MACHINE head-head"), "finding", ""),
        ("a remark", after("PPRINT/SWEEP 1", "REMARK/HELLO", "PPRINT/HELLO", "$$ HELLO"), "none", ""),
        ("small letters", sub("GOTO", "goto", 0), "none", ""),
        ("colours of the screen", after("PPRINT/SWEEP 1", "PAINT/COLOR,5"), "none", ""),
    )
]

EDITS: tuple[Edit, ...] = (
    *_SPINDLE, *_FEED, *_FRAME, *_TOOL, *_MOTION, *_STOPS, *_TOLERANCE, *_COOLANT, *_HEADER, *_FLOW, *_TEXT,
    *_ISO, *_APT,
)  # fmt: skip


# --- systematic edits -------------------------------------------------------------------------------------------------

_FACT = re.compile(r"(?:; |PPRINT/)(TOOL|REFERENCE|FRAME|ROTARY) ")
_STRETCH = re.compile(r"(?:; |PPRINT/)(APPROACH|SWEEP|PASS|RETRACT|LINK) \d")
_POSE = re.compile(r"(?:LN? X|(?:G0[01] )?(?:G4\d )?(?:G90 )?X|GOTO/)")
_WORDS = re.compile(r"(?<![A-Z])([A-Z]+)([+-]?\d+(?:\.\d*)?)(?![\d.])")


def control_lines(blocks: Blocks, poses: bool) -> list[int]:
    """Lines that are no poses and, with `poses`, the first and last pose of every stretch."""
    inner = {index for index, block in enumerate(blocks) if _POSE.match(block)}
    if poses:
        inner = {index for index in inner if all(_is_pose(blocks, k) for k in (index - 1, index + 1))}
    return [index for index in range(len(blocks)) if index not in inner]


def _is_pose(blocks: Blocks, index: int) -> bool:
    return bool(_POSE.match(blocks[index]) or blocks[index].startswith("FEDRAT"))


def line_edits(original: Posted, kind: str, style: str, poses: bool) -> Iterator[Edit]:
    """Each control line left out, doubled, and swapped with the next."""
    blocks = blocks_of(original.text, kind)
    for index in control_lines(blocks, poses):
        line = f"line {index} ({blocks[index].strip()[:40]})"
        yield Edit(f"{line} left out", _without(index), kind=kind, style=style)
        yield Edit(f"{line} twice", _twice(index), kind=kind, style=style)
        if index + 1 < len(blocks):
            yield Edit(f"{line} after the next", _swapped(index), kind=kind, style=style)


def _without(index: int) -> Change:
    return lambda blocks: [*blocks[:index], *blocks[index + 1 :]]


def _twice(index: int) -> Change:
    return lambda blocks: [*blocks[: index + 1], *blocks[index:]]


def _swapped(index: int) -> Change:
    return lambda blocks: [*blocks[:index], blocks[index + 1], blocks[index], *blocks[index + 2 :]]


def number_edits(original: Posted, kind: str, style: str, every: int = 0) -> Iterator[Edit]:
    """Numbers of control lines, and of every so many lines whatever they are, changed by what matters."""
    blocks = blocks_of(original.text, kind)
    chosen = set(control_lines(blocks, every > 0)) | set(range(0, len(blocks), every) if every else ())
    for index in sorted(chosen):
        block = blocks[index]
        if block.startswith((";", "BLK", "PPRINT", "G30", "G31", "PARTNO")) and not _FACT.match(block):
            continue
        for found_word in _WORDS.finditer(block):
            for value in _other_values(found_word[1], found_word[2], block):
                new = block[: found_word.start(2)] + value + block[found_word.end(2) :]
                name = f"line {index}: {found_word[0]} to {found_word[1]}{value}"
                yield Edit(name, _replaced(index, new), kind=kind, style=style)


def _replaced(index: int, new: str) -> Change:
    return lambda blocks: [*blocks[:index], new, *blocks[index + 1 :]]


def _other_values(letter: str, value: str, block: str) -> list[str]:
    if letter in ("X", "Y", "Z") and not block.startswith("CYCL"):
        return [f"{float(value) + 1.0:+.4f}", f"{float(value) - 1.0:+.4f}"]
    if letter in ("A", "B", "C"):
        return [f"{float(value) + 2.0:+.4f}"]
    if letter in ("TX", "TY", "TZ"):
        return [f"{float(value) + 0.1:+.7f}"]
    if letter == "F":
        return ["0", f"{10 * int(value)}"]
    if letter == "S":
        return ["0", f"{int(value) + 1000}"]
    if letter == "T":
        return ["0.5"] if "." in value else [f"{int(value) + 1}"]
    return {"TA": ["5"], "M": ["97"] if value in ("128", "3") else [], "Q": []}.get(letter, [])


_BY_KEY = {
    **{word: "control" for word in ("M128", "M129", "FUNCTION")},
    **{word: "spindle" for word in ("M5", "SPINDL")},
    **{word: "coolant" for word in ("M7", "M8", "M9", "COOLNT")},
    **{word: "preset" for word in ("G247", "Q339=+1")},
    **{word: word for word in ("PLANE", "UNITS")},
}
"""What words of posted programs set, by the first word of a line."""
_WITHOUT_EFFECT = frozenset(("BLK", "PPRINT", "G30", "G31", "PARTNO", "M30", "MULTAX", "M126", "M127"))
"""What moves nothing; the shorter way of rotary axes is followed by the verification, so that it is judged."""
_ALWAYS = ("control", "PLANE", "preset", "tool", "UNITS")
_AT_FEED = (*_ALWAYS, "spindle", "coolant", "tolerance")
_LIKE = 1.1
"""Feeds that differ by no more than this factor are those of neighbouring blocks."""


@dataclass(frozen=True, slots=True)
class Step:
    """One thing that a machine does: the words, whether at rapid, the feed (0 at rapid), and what holds for it."""

    code: str
    rapid: bool
    feed: float
    holds: tuple[tuple[str, object], ...]

    def like(self, other: Step) -> bool:
        """The same, but for feeds that differ a little, or a rapid that goes at a feed known before."""
        if self.code != other.code:
            return False
        if self.rapid and not other.rapid:
            return other.feed > 0.0 and set(self.holds) <= set(other.holds)
        feeds = sorted((self.feed, other.feed))
        return self.rapid == other.rapid and self.holds == other.holds and feeds[1] <= _LIKE * feeds[0]


def trace(text: str, kind: str) -> list[Step]:
    """What a machine does by a posted program, told by the few words that posts use: an authority for mutants.

    Written for the edits of posted programs alone; what it does not know is a step of its own.
    """
    state: dict[str, str] = {"control": "FUNCTION RESET TCPM"}
    steps: list[Step] = []
    facts = tuple(sorted({block for block in blocks_of(text, kind) if _FACT.match(block)}))
    for block in blocks_of(text, kind):
        code = block.partition(";")[0].strip()
        word = re.split("[ /]", code)[0]
        if not code or word in _WITHOUT_EFFECT:
            continue
        if code.startswith("CYCL DEF 32"):
            state["tolerance"] = code if "32.0" in code else state.get("tolerance", "") + code
        elif word == "G62":
            state["tolerance"] = code
        elif word in _BY_KEY:
            state[_BY_KEY[word]] = "FUNCTION RESET TCPM" if word == "M129" else code
        elif word in ("RAPID", "FEDRAT"):
            state["feed"] = code.replace("FEDRAT/", "").removesuffix(",MMPM")
        elif code != "CYCL DEF 247 DATUM SETTING ~":
            _step(code, word, state, steps, facts)
    return steps


def _step(code: str, word: str, state: dict[str, str], steps: list[Step], facts: tuple[str, ...]) -> None:
    """One line that moves, or whatever else it does."""
    if feed := re.search(r" F(\d+)", code):
        state["feed"] = feed[1]
    if " M3" in code:
        state["spindle"] = "M3"
    changes = bool(re.match(r"TOOL CALL|LOADTL|T\d", code))
    if changes:
        state["tool"], state["spindle"] = code, ""
    retract = "M140" in code or word == "RETRCT"
    rapid = "FMAX" in code or "G00" in code or state.get("feed") == "RAPID" or retract
    pose = bool(_POSE.match(code))
    # A retract goes along the tool axis, whatever holds; what is on matters in the cut.
    name = word.startswith(("BEGIN", "END", "%"))
    keys = () if retract or changes or name else _AT_FEED if pose and not rapid else _ALWAYS
    holds = (*((key, state.get(key, "")) for key in keys), ("facts", facts))
    value = float(state.get("feed") or 0.0) if pose and not rapid else 0.0
    if state.get("feed") == "RAPID":
        state["feed"] = ""
    step = Step(re.sub(r" (?:F\d+|M3|R0)(?= |$)", "", code), rapid, value, holds)
    # The same again directly after itself moves nothing; a tool that has just been changed, or none, is retracted.
    idle = retract and (not steps or re.match(r"TOOL CALL|LOADTL|T\d", steps[-1].code))
    if not idle and not (steps and steps[-1] == step):
        steps.append(step)


def alike(one: list[Step], other: list[Step]) -> bool:
    """Whether a machine does the same by both traces, the first being the posted program's."""
    return len(one) == len(other) and all(a.like(b) for a, b in zip(one, other, strict=True))


def only_moved(one: list[Step], other: list[Step]) -> bool:
    """Whether feed moves of the other trace are under nothing that the first has not: then motion alone differs."""
    held = {step.holds for step in one if step.feed}
    return all(step.holds in held for step in other if step.feed)
