"""Whether a program may go to a machine: its verification must exist, be of this text, and have no findings."""

from __future__ import annotations

import json
from hashlib import sha256
from pathlib import Path

JUDGEMENT = ".verification.json"


def objection(program: Path) -> str | None:
    """Why `program` must not be sent, from the verification beside it; None if it may be.

    A program that another one calls is judged with that one: then the verification of the calling program will do.
    """
    reason = _objection(program, program.with_name(program.name + JUDGEMENT), "program_sha256")
    if reason is None:
        return None
    for path in sorted(program.parent.glob("*" + JUDGEMENT)):
        if program.name in _called(path):
            return _objection(program, path, "called_sha256")
    return reason


def _objection(program: Path, path: Path, key: str) -> str | None:
    """The same, from the verification in `path`, which has the program's hash under `key`."""
    try:
        judgement = json.loads(path.read_bytes())
    except FileNotFoundError:
        return f"no verification ({path.name} is missing)"
    except (OSError, ValueError):
        return f"no readable verification ({path.name})"
    if not isinstance(judgement, dict) or not isinstance(judgement.get("findings"), list):
        return f"{path.name} is no verification"
    stated = judgement.get(key)
    if (stated.get(program.name) if isinstance(stated, dict) else stated) != _digest(program):
        return f"{path.name} is the verification of another text"
    called = judgement.get("called_sha256")
    for name, digest in called.items() if isinstance(called, dict) else ():
        part = program.with_name(name)
        if not part.is_file() or _digest(part) != digest:
            return f"{path.name} was made with another {name}"
    if judgement["findings"]:
        codes = sorted(
            {str(finding.get("code", "?")) if isinstance(finding, dict) else "?" for finding in judgement["findings"]}
        )
        return f"{path.name} has {len(judgement['findings'])} findings ({', '.join(codes)})"
    return None


def _called(path: Path) -> set[str]:
    """Names of the programs that were judged with the one whose verification is in `path`."""
    try:
        called = json.loads(path.read_bytes()).get("called_sha256")
    except (OSError, ValueError, AttributeError):
        return set()
    return set(called) if isinstance(called, dict) else set()


def _digest(program: Path) -> str:
    digest = sha256()
    with program.open("rb") as stream:
        while piece := stream.read(1 << 20):
            digest.update(piece)
    return digest.hexdigest()
