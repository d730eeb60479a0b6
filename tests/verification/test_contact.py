"""Rapids, stops and dwells in the cut, on a plane that the cone lies on."""

from __future__ import annotations

import numpy as np
import pytest

from conflank_cli.verification.contact import TOUCHING, in_contact
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.kinematics import CAD_FRAME
from conflank_cli.verification.poses import poses_on_part
from conflank_cli.verification.reader import read_program
from tests.verification.scenes import T1, TCPM, lying_on_plane, plane_face, program, scene_of

UNDERCUT = 0.01
FLANK = plane_face((10.0, 30.0), (1.0, 20.0))
SURFACE = np.array([[x, y, 0.0] for x in np.arange(10.0, 30.5, 0.5) for y in np.arange(1.0, 20.5, 0.5)])


def cut(*body: str, height: float = 0.0) -> str:
    """The cone set down on the plane at x = 12, then what is asked."""
    tilt, tip, _ = lying_on_plane(T1, height)
    words = f"Y{tip[1]:+.9f} Z{tip[2]:+.9f} A{tilt:+.9f} C+0"
    start = [f"L A{tilt:+.9f} C+0 R0 FMAX", TCPM, f"L X+12 {words} F500"]
    return program([*start, *body, "L Z+60 F2000", "FUNCTION RESET TCPM", "L M140 MB MAX"])


def found(text: str) -> list[tuple[str, int | None]]:
    read = read_program(text)
    poses = poses_on_part(read.moves, read.letters, CAD_FRAME, np.zeros(len(read.moves.block)))
    findings = in_contact(read, poses, [T1] * len(read.tool_calls), SURFACE, UNDERCUT)
    assert {finding.code for finding in findings} <= {"CF120"}
    return [(finding.text, finding.block) for finding in findings]


def test_a_steady_cut_has_nothing() -> None:
    assert found(cut("; SWEEP 1", "L X+28 F1000", "; RETRACT 1")) == []


@pytest.mark.parametrize("words", ["M0", "M1", "STOP", "M5", "M19", "CYCL DEF 9.0 DWELL\nCYCL DEF 9.1 V.ZEIT 2"])
def test_stops_and_dwells_in_the_cut(words: str) -> None:
    (text, block) = found(cut("L X+20 F1000", *words.split("\n"), "L X+28"))[0]
    assert "touches the face" in text
    assert words.split("\n")[-1] in cut("L X+20 F1000", *words.split("\n")).splitlines()[block or 0]


@pytest.mark.parametrize("words", ["M0", "M1", "STOP", "M5"])
def test_stops_off_the_face_are_harmless(words: str) -> None:
    assert found(cut("L X+20 F1000", "L Z+40", words, "L X+28")) == []


@pytest.mark.parametrize(("gap", "touches"), [(0.0, True), (UNDERCUT + 0.9 * TOUCHING, True), (0.1, False)])
def test_rapids_in_contact(gap: float, touches: bool) -> None:
    result = found(cut("L X+28 FMAX", height=gap))
    assert bool(result) == touches


def test_a_rapid_within_a_sweep_whatever_it_touches() -> None:
    text, _ = found(cut("; SWEEP 3", "L X+20 F1000", "L X+28 FMAX", "; RETRACT 3", height=1.0))[0]
    assert text == "rapid within sweep 3"


def test_the_judge_asks_for_it() -> None:
    result = verify_program(cut("; SWEEP 1", "L X+20 F1000", "M0 M8", "M3", "L X+28"), scene_of(FLANK), "", 1000)
    assert "CF120" in {finding.code for finding in result.findings}
