"""APT cutter location data for other posts and simulators: tip and tool axis of every pose, in part coordinates.

``RETRCT`` stands for the retract along the tool axis to the limit of the machine; the rotary axes are brought to their
places there. Words: PARTNO, PPRINT, UNITS, MULTAX, LOADTL, SPINDL, COOLNT, RAPID, FEDRAT, GOTO, RETRCT, FINI.

Source: ISO 3592 and ISO 4343 (post processor words), as text.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from postprocessors.errors import PostError
from postprocessors.facts import facts, short
from postprocessors.machines.machine import Machine
from postprocessors.path_checks import check_cutters, check_path
from postprocessors.post import Post, ProgramFile, ProgramOptions, check_options
from postprocessors.toolpath import Operation, Purpose, Stretch, ToolPath

Array = npt.NDArray[np.float64]

COORDINATE_LIMIT = 999999.0
TOOL_LIMIT = 99999999
SPINDLE_LIMIT = 999999.0
WIDTH = 72
"""Characters in a line; a statement that needs more goes on in the next, after a dollar sign."""
_COOLANT = {"M7": "COOLNT/MIST", "M8": "COOLNT/FLOOD"}


def write_apt(path: ToolPath, machine: Machine, options: ProgramOptions) -> tuple[ProgramFile, ...]:
    """The cutter location data of a tool path: ASCII text, lines ended by CR LF.

    Raises
    ------
    PostError: the path means nothing, or an option does not exist in this format.
    """
    check_options(POST, options)
    if not isinstance(options.datum, int):
        found = f"a shift by {list(options.datum)}"
        raise PostError("[program] datum", found, "a number (the data know no datum)", "Use [setup] translate.")
    check_path(path, COORDINATE_LIMIT)
    check_cutters(path, TOOL_LIMIT, SPINDLE_LIMIT)
    lines = [f"PARTNO/{path.name}"]
    lines += [f"PPRINT/{fact}" for fact in facts(path, machine, options, WIDTH - len("PPRINT/"))]
    lines += ["UNITS/MM", "MULTAX/ON"]
    for operation in path.operations:
        lines += _operation(operation, options)
    lines.append("FINI")
    return (ProgramFile(path.name, "\r\n".join(lines) + "\r\n"),)


POST = Post(suffix=".APT", styles=("multax",), write=write_apt, why="every pose has its tool axis")


def _operation(operation: Operation, options: ProgramOptions) -> Iterator[str]:
    yield f"LOADTL/{operation.cutter.number}"
    yield "RETRCT"
    yield f"SPINDL/{short(operation.cutter.spindle_rpm, 3)},RPM,CLW"
    started, modal, before = False, -1.0, ""
    last: Stretch | None = None
    for stretch in operation.stretches:
        entering = last is None or last.cut != stretch.cut
        entering |= (
            last is not None
            and last.purpose in (Purpose.RETRACT, Purpose.UPRIGHT)
            and stretch.purpose is Purpose.APPROACH
        )
        entering &= last is None or stretch.purpose is not Purpose.LINK
        if entering and last is not None:
            yield "RETRCT"
        if stretch.purpose is not Purpose.UPRIGHT:
            yield f"PPRINT/{stretch.purpose.name} {stretch.cut}"
        for number, (goto, feed) in enumerate(zip(_gotos(stretch), stretch.feed.tolist(), strict=True)):
            enters = entering and number == 0
            if goto == before and not enters:
                continue
            before = goto
            if enters or feed == 0.0:
                yield "RAPID"
                # A rapid takes the place of the feed, so that it has to be given again.
                modal = -1.0
            elif feed != modal:
                modal = feed
                yield f"FEDRAT/{short(feed)},MMPM"
            yield goto
            if enters and not started:
                started = True
                if options.coolant != "none":
                    yield _COOLANT[options.coolant]
        last = stretch
    yield "RETRCT"
    if options.coolant != "none":
        yield "COOLNT/OFF"
    yield "SPINDL/OFF"


def _gotos(stretch: Stretch) -> list[str]:
    axis = stretch.axis / np.linalg.norm(stretch.axis, axis=1, keepdims=True)
    # Adding zero turns -0 into +0.
    rows = np.hstack([np.round(stretch.tip, 4), np.round(axis, 7)]) + 0.0
    texts = ["GOTO/{:.4f},{:.4f},{:.4f},{:.7f},{:.7f},{:.7f}".format(*row) for row in rows.tolist()]
    return [text if len(text) <= WIDTH else _folded(text) for text in texts]


def _folded(text: str) -> str:
    parts = text.split(",")
    return f"{','.join(parts[:3])},$\r\n{','.join(parts[3:])}"
