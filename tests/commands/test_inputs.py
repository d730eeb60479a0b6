"""What commands say while they read their inputs."""

import os
import subprocess
import sys
from pathlib import Path

SCRIPT = """
from pathlib import Path
from conflank_cli.commands.inputs import say_if_first
from conflank_cli.geometry.kernels.footpoint import footpoints
from conflank_cli.options import Talk
from conflank_cli.progress import SilentProgress

talk = Talk(quiet=False, verbose=False, progress=SilentProgress())
say_if_first(talk)
folder = Path(footpoints.stats.cache_path)
folder.mkdir(parents=True, exist_ok=True)
(folder / "footpoint.footpoints-1.py311.nbi").touch()
say_if_first(talk)
"""


def test_the_first_run_says_what_it_waits_for_wherever_kernels_are_kept(tmp_path: Path) -> None:
    """Once: not any more when something has been compiled."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_DISABLE_JIT": "0"}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stderr.splitlines() == ["The kernels are compiled once, at the first run: about a minute more."]
