"""Job files for faces that have none of their own."""

from __future__ import annotations

from conflank_cli.tool import CATALOGUE, Tool


def job_text(
    file: str,
    face: int,
    side: str,
    tool: Tool,
    *,
    tolerance: float,
    coverage: float,
    program: str,
    rotate_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> str:
    """A job for one face and one tool with the check geometry off.

    Parameters
    ----------
    file: the part, relative to the job file or absolute.
    side: "outside" or "inside", along the face's oriented normal or against it.
    tolerance: overcut and undercut, mm.
    rotate_deg: turns the part so that the tool axis stands up on the table.
    """
    lines = [
        "[part]",
        f"file = '{file}'",
        'check_faces = "none"',
        "[[part.design]]",
        f"face = {face}",
        f'side = "{side}"',
        "[tools]",
        f'use = ["{tool.name}"]',
    ]
    if tool.name not in CATALOGUE:
        lines += [
            f"[tools.define.{tool.name}]",
            f"r_min = {tool.r_min}",
            f"r_max = {tool.r_max}",
            f"length = {tool.length}",
            f"number = {tool.number}",
        ]
    lines += [
        "[tolerance]",
        f"overcut = {tolerance}",
        f"undercut = {tolerance}",
        "[selection]",
        f"coverage = {coverage}",
        "[setup]",
        f"rotate_deg = {list(rotate_deg)}",
        "[program]",
        f'name = "{program}"',
    ]
    return "\n".join(lines) + "\n"
