"""Whether a program may go to a machine: its verification must exist, be of these very bytes, and have no findings."""

from __future__ import annotations

from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from conflank_cli.errors import EXIT_FINDINGS, EXIT_INPUT, ConflankError, InputError
from conflank_cli.verification.result import Verification, from_json

JUDGEMENT = ".verification.json"

_EXPECTED = "a verification of this text without findings"


class Refused(ConflankError):
    """A program that must not be sent; exit code 1 where its verification is sound and has findings, else 3."""

    def __init__(self, program: Path, found: str, exit_code: int = EXIT_INPUT) -> None:
        next_step = f"conflank verify {program} --job JOB, or --unverified if you answer for it."
        super().__init__(str(program), found, _EXPECTED, next_step)
        self.exit_code = exit_code


class _Judged(NamedTuple):
    """A verification and the file it stands in."""

    path: Path
    verification: Verification


def release(program: Path, digest: str) -> Verification:
    """The verification that lets a program go to a machine.

    A program that another one calls is judged with that one: then the verification of the calling program will do.

    Parameters
    ----------
    program: its file, beside which the verification is looked for.
    digest: SHA-256 of the bytes that would be sent.

    Raises
    ------
    Refused: no verification, one of other bytes, one that has findings, or one without the hashes of what it was
        judged against.
    InputError: a verification that this version cannot read.
    """
    own = program.with_name(program.name + JUDGEMENT)
    try:
        return _released_alone(program, digest, own)
    except Refused as refused:
        reason = refused
    for judged in _callers(program, own):
        if judged.verification.called_sha256[program.name] != digest:
            raise Refused(program, f"{judged.path.name} is the verification of another {program.name}")
        caller = judged.path.with_name(judged.path.name.removesuffix(JUDGEMENT))
        if _digest(caller) != judged.verification.program_sha256:
            raise Refused(program, f"{judged.path.name} is the verification of another {caller.name}")
        return _released(program, judged)
    raise reason


def objection(program: Path, digest: str) -> str | None:
    """Why a program must not be sent, in one sentence; None if it may be. See `release`."""
    try:
        release(program, digest)
    except Refused as refused:
        return refused.found
    except InputError as error:
        return f"{error.where}: {error.found}"
    return None


def _released_alone(program: Path, digest: str, own: Path) -> Verification:
    """The same, from the program's own verification."""
    if not own.exists():
        raise Refused(program, f"no verification ({own.name} is missing)")
    verification = _read(own)
    if verification.program_sha256 != digest:
        raise Refused(program, f"{own.name} is the verification of another text")
    return _released(program, _Judged(own, verification))


def _released(program: Path, judged: _Judged) -> Verification:
    """The verification, if nothing in it speaks against sending a program that it is of."""
    path, verification = judged
    for name, digest in verification.called_sha256.items():
        if _digest(program.with_name(name)) != digest:
            raise Refused(program, f"{path.name} was made with another {name}")
    against = verification.against
    for each in (against.part, against.machine, *against.obstacles):
        if each.sha256 is None:
            raise Refused(program, f"{path.name} does not give the hash of {each.name}, which it was made against")
    if verification.findings:
        codes = ", ".join(sorted({finding.code for finding in verification.findings}))
        raise Refused(program, f"{path.name} has {len(verification.findings)} findings ({codes})", EXIT_FINDINGS)
    return verification


def _read(path: Path) -> Verification:
    data = _bytes(path)
    if data is None:
        raise InputError(str(path), "no readable file", "a verification", "Verify the program again.")
    return from_json(data, path.name)


def _callers(program: Path, own: Path) -> Iterator[_Judged]:
    """Verifications in the folder, other than its own, of programs that call this one."""
    for path in sorted(program.parent.glob("*" + JUDGEMENT)):
        if path == own:
            continue
        try:
            verification = _read(path)
        except InputError:
            # Not the verification of this program; where it is that of a calling program, this one stays unverified.
            continue
        if program.name in verification.called_sha256:
            yield _Judged(path, verification)


def _digest(program: Path) -> str | None:
    """SHA-256 of a file; None where there is none."""
    data = _bytes(program)
    return None if data is None else sha256(data).hexdigest()


def _bytes(path: Path) -> bytes | None:
    """What is in a file; None for anything else, such as a pipe, which would be waited for."""
    try:
        return path.read_bytes() if path.is_file() else None
    except OSError:
        return None
