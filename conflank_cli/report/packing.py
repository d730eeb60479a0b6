"""Arrays inside a page: whole numbers where that is enough, sorted by bytes, deflated and written in base64.

The page's script undoes it (web/data.js).
"""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# The levels above this one take one and a half to twelve times as long, for 0.5 to 1.7 % fewer bytes.
_LEVEL = 6


class Packer:
    """Collects arrays; `entries` tells the page where they are, `text` is all of them."""

    def __init__(self) -> None:
        self.entries: dict[str, dict[str, Any]] = {}
        self._pieces: list[bytes] = []
        self._size = 0

    def exact(self, name: str, array: npt.NDArray[Any], kind: str) -> None:
        """Add an array as it is, in a type of NumPy such as "f8"."""
        self._add(name, np.ascontiguousarray(array, dtype=f"<{kind}"), kind, False)

    def whole(self, name: str, array: npt.NDArray[Any], kind: str) -> None:
        """Add whole numbers, as differences of neighbours."""
        self._add(name, np.ascontiguousarray(array, dtype=f"<{kind}"), kind, True)

    def points(self, name: str, points: Array) -> None:
        """Add points (N, 3) to be drawn: in 65535 steps of their box along each coordinate."""
        low = points.min(axis=0) if len(points) else np.zeros(3)
        step = np.ptp(points, axis=0) / 65535.0 if len(points) else np.zeros(3)
        steps = np.round((points - low) / np.where(step > 0.0, step, 1.0))
        self._add(name, np.ascontiguousarray(steps, dtype="<u2"), "u2", False)
        self.entries[name] |= {"low": low.tolist(), "step": step.tolist()}

    def _add(self, name: str, array: npt.NDArray[Any], kind: str, differences: bool) -> None:
        flat = array.reshape(-1)
        if differences:
            # They wrap round, and so do the sums in the page.
            flat = np.diff(flat, prepend=flat.dtype.type(0))
        raw = flat.view(np.uint8).reshape(-1, flat.dtype.itemsize).T.tobytes()
        self.entries[name] = {"type": kind, "offset": self._size, "bytes": len(raw)}
        if differences:
            self.entries[name]["differences"] = True
        self._pieces.append(raw)
        self._size += len(raw)

    def text(self) -> str:
        """All arrays, deflated, in base64."""
        return base64.b64encode(zlib.compress(b"".join(self._pieces), _LEVEL)).decode("ascii")
