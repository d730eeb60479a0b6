"""Verifications of programs that nobody has verified, for tests of what is made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path

from conflank_cli.verification.findings import Finding
from conflank_cli.verification.result import (
    Against,
    ClearanceFigures,
    Clearances,
    FileHash,
    GapFigures,
    Limits,
    Placement,
    Region,
    Verification,
)

NOTHING_NEAR = ClearanceFigures(None, None)
AGAINST = Against(
    program_version="0.1.0",
    part=FileHash("blade.step", "1" * 64),
    obstacles=(FileHash("fixture.stl", "2" * 64),),
    machine=FileHash("ac-table", "3" * 64),
    job_sha256="4" * 64,
    limits=Limits(0.01, 0.012, 0.1, 0.2, 0.5, 1.0, 0.9),
    regions=(Region(7, "outside", (0.0, 1.0, 0.0, 1.0)), Region(9, "inside", (0.0, 0.5, 0.0, 1.0))),
    placement=Placement(3, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 24, (0, 5)),
)


def verification_of(
    data: bytes,
    findings: Sequence[str] = (),
    called: Mapping[str, bytes] | None = None,
    against: Against = AGAINST,
    unknown_moves: int = 2,
) -> Verification:
    """A verification of a program with these bytes, with findings of these codes, and of the programs it calls."""
    return Verification(
        program="BLADE1.H",
        program_sha256=sha256(data).hexdigest(),
        against=against,
        judged={},
        coverage=0.9512,
        coverage_flank=0.9512,
        overcut_max_um=3.25,
        overcut_max_at=None,
        stock_max_um=8.5,
        stock_max_at=None,
        gap_um=GapFigures(1.0, 2.0),
        step_max_um=None,
        faces=(),
        sweeps=(),
        passes=(),
        clearance_mm=Clearances(NOTHING_NEAR, NOTHING_NEAR, NOTHING_NEAR, NOTHING_NEAR),
        time_s=60.0,
        control_tolerance_um=None,
        unknown_moves=unknown_moves,
        findings=tuple(Finding(code, "something is wrong") for code in findings),
        called_sha256={name: sha256(part).hexdigest() for name, part in (called or {}).items()},
    )


def judge(path: Path, findings: Sequence[str] = (), called: Mapping[str, bytes] | None = None) -> None:
    """Write a verification of a program as its file is now."""
    verification = verification_of(path.read_bytes(), findings, called)
    path.with_name(path.name + ".verification.json").write_bytes(verification.to_json())
