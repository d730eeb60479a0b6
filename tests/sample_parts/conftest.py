"""The sample parts are scripts beside the package, not part of it: make their modules importable."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "sample_parts"))
