"""What holds for all tests."""

from __future__ import annotations

import os

# As the command line has it: rounding differs with the threads of OpenBLAS, and what commands write as processes is
# compared byte by byte with what they write in this one. To be set before NumPy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
