"""What is rehearsed while the first run compiles."""

from __future__ import annotations

import pytest

from conflank_cli.commands.first_run import rehearse


def test_the_rehearsal_goes_through_every_stage() -> None:
    """The cone lies on the face: all of it is covered, exactly, and nothing is found."""
    verification = rehearse()
    assert verification.coverage == pytest.approx(1.0)
    assert verification.gap_um.mean_abs is not None and verification.gap_um.mean_abs < 0.1
    assert not verification.findings
    assert [figures.tool for figures in verification.sweeps] == ["T1"]
