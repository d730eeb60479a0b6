"""Whether a program may go to a machine: its verification must exist, be of this text, and have no findings."""

from __future__ import annotations

import json
from hashlib import sha256
from pathlib import Path

JUDGEMENT = ".verification.json"


def objection(program: Path) -> str | None:
    """Why `program` must not be sent, from the verification beside it; None if it may be."""
    path = program.with_name(program.name + JUDGEMENT)
    try:
        judgement = json.loads(path.read_bytes())
    except FileNotFoundError:
        return f"no verification ({path.name} is missing)"
    except (OSError, ValueError):
        return f"no readable verification ({path.name})"
    if not isinstance(judgement, dict) or not isinstance(judgement.get("findings"), list):
        return f"{path.name} is no verification"
    digest = sha256()
    with program.open("rb") as stream:
        while piece := stream.read(1 << 20):
            digest.update(piece)
    if judgement.get("program_sha256") != digest.hexdigest():
        return f"{path.name} is the verification of another text"
    if judgement["findings"]:
        codes = sorted(
            {str(finding.get("code", "?")) if isinstance(finding, dict) else "?" for finding in judgement["findings"]}
        )
        return f"{path.name} has {len(judgement['findings'])} findings ({', '.join(codes)})"
    return None
