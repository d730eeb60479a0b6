"""The CAD kernel in a process of its own, which reads one file and ends.

The kernel takes about 0.6 s to load and 250 MB, and nothing needs it once the faces of a part are numbers. So a command
starts this process first of all: it loads the kernel while the command reads its job, and reads the part while the
command imports what it will compute with. It hands over the design faces as numbers as soon as it has them, then the
triangles and surfaces of what nothing may touch, which take it longest and which the first stage needs last; then its
memory is free again.

This module imports nothing that is slow: a command starts with it.
"""

from __future__ import annotations

import gc
import os
import pickle
import signal
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from conflank_cli.errors import ConflankError, InputError
from conflank_cli.once import Once

if TYPE_CHECKING:
    from conflank_cli.cad.part import FaceGeometry, Part, PartFace, Piece

Found = TypeVar("Found")
Known = Mapping[int, "Tried[FaceGeometry]"]
"""What came of converting faces, by number."""


class Meshing(NamedTuple):
    """Faces that nothing may touch.

    numbers: which to triangulate; deflection: how closely, mm; surfaces: which of them are handed over with the
    triangles, since they are no design faces.
    """

    numbers: tuple[int, ...]
    deflection: float
    surfaces: tuple[int, ...]


class Checked(NamedTuple):
    """What is handed over last: triangles of the faces that nothing may touch, and what came of converting them."""

    triangles: Tried[list[Piece]]
    surfaces: Known


class Wanted(NamedTuple):
    """What is wanted of a CAD file.

    Attributes
    ----------
    path, scale: as for `read_part`.
    design: faces whose geometry is wanted, by number or name; None for all.
    check: faces whose triangles are wanted, as in `Part.to_check`.
    """

    path: Path
    scale: float = 1.0
    design: Sequence[int | str] | None = None
    check: str | Sequence[int | str] = "none"


@dataclass(frozen=True, slots=True)
class Tried(Generic[Found]):
    """What came of something: its result, or the error it raised."""

    result: Found | None
    error: Exception | None = None

    def found(self) -> Found:
        """The result; raises the error."""
        if self.error is not None:
            raise self.error
        assert self.result is not None
        return self.result


def _tried(attempt: Callable[[], Found]) -> Tried[Found]:
    """What comes of it, such that another process can be told."""
    try:
        return Tried(attempt())
    except Exception as error:
        text = "".join(traceback.format_exception(error))
        # Errors of the kernel's own cannot be carried over, and would have it loaded there.
        own = isinstance(error, ConflankError) or type(error).__module__ == "builtins"
        told = error if own else RuntimeError(f"{type(error).__name__}: {error}")
        told.add_note(f"In the process that reads CAD files:\n{text}")
        return Tried(None, told)


class KernelProcess:
    """A process that loads the CAD kernel as soon as this is made, reads one file, and ends with the context."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        # Where the kernel is loaded already there is nothing to be gained.
        if "OCP" in sys.modules:
            return
        program = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
        # Where there can be no other process, this one reads.
        with suppress(OSError):
            # In a group of its own, for Ctrl-C on a terminal goes to a whole group, and this process passes it on.
            self._process = subprocess.Popen(
                [sys.executable, "-c", program],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                process_group=0,
            )

    def __enter__(self) -> KernelProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()

    def read(self, wanted: Wanted) -> Callable[[], Part]:
        """Have the file read; what is returned waits for the part, or raises what `read_part` raises.

        Only what is wanted of the part can be asked of it, and within the context: triangles and surfaces of what
        nothing may touch are waited for when they are asked for. A file in JSON has no use for the kernel, and is read
        here.
        """
        process = self._process
        if process is None or process.stdin is None or wanted.path.suffix.lower() == ".json":
            from conflank_cli.cad.reader import read_part

            return partial(read_part, wanted.path, wanted.scale)
        # Where the process is gone, the answer says so.
        with suppress(BrokenPipeError):
            process.stdin.write(pickle.dumps(wanted))
            process.stdin.flush()
        return partial(_answer, process, wanted.path.name)


def _answer(process: subprocess.Popen[bytes], file: str) -> Part:
    """The part that the process hands over, with triangles that are still to come."""
    answer: Tried[tuple[Part, Meshing | None]] = _next(process, file)
    part, meshing = answer.found()
    if meshing is None:
        return part
    checked: Once[Checked] = Once(partial(_next, process, file))
    faces = tuple(
        replace(face, load=partial(_surface, checked, face.number)) if face.number in meshing.surfaces else face
        for face in part.faces
    )
    return replace(part, faces=faces, triangulate=partial(_triangles, checked, meshing))


def _next(process: subprocess.Popen[bytes], file: str) -> Any:
    """The next thing that the process hands over."""
    assert process.stdout is not None
    try:
        return pickle.load(process.stdout)
    except (EOFError, pickle.UnpicklingError):
        code = process.wait()
    end = f"exit code {code}" if code >= 0 else signal.Signals(-code).name
    raise InputError(
        file,
        f"a file on which the CAD kernel breaks down ({end})",
        "a complete and sound CAD file",
        "Export the part again, or in another format.",
    )


def serve() -> None:
    """What the process does: load the kernel, read what is wanted from standard input, answer on standard output."""
    # All that the kernel makes as it is loaded stays: to look through it for garbage would be a quarter of the time.
    gc.disable()
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    # Where there is no kernel, that is said when a file is read that needs it.
    with suppress(ImportError):
        import_module("OCP")
    try:
        wanted = pickle.load(sys.stdin.buffer)
    except EOFError:
        # The command had no use for it.
        os._exit(0)
    with suppress(BrokenPipeError):
        for answer in _read(wanted):
            pickle.dump(answer, answers, protocol=pickle.HIGHEST_PROTOCOL)
            answers.flush()
    # To take the kernel apart in order would be half as long again as to load it.
    os._exit(0)


def _read(wanted: Wanted) -> Iterator[Tried[Any] | Checked]:
    """The part with the geometry of its design faces, and what is to be checked; then that, if there is any."""
    from conflank_cli.cad.reader import read_part
    from conflank_cli.cad.triangulation import DEFLECTION_MM

    tried = _tried(partial(read_part, wanted.path, wanted.scale))
    if tried.result is None:
        yield tried
        return
    part, numbers = tried.result, _to_check(tried.result, wanted)
    geometry = {face.number: _tried(face.load) for face in _design(part, wanted)}
    others = tuple(number for number in numbers if number not in geometry)
    meshing = Meshing(numbers, DEFLECTION_MM, others) if part.triangulate is not None and numbers else None
    faces = tuple(replace(face, load=partial(_geometry, geometry, face.number)) for face in part.faces)
    yield Tried((replace(part, faces=faces, triangulate=None), meshing))
    if part.triangulate is not None and meshing is not None:
        triangles = _tried(partial(part.triangulate, meshing.numbers, meshing.deflection))
        yield Checked(triangles, {number: _tried(part.faces[number].load) for number in meshing.surfaces})


# Where there is no such face, that is said where the job is looked at.
def _design(part: Part, wanted: Wanted) -> Sequence[PartFace]:
    """The faces whose geometry is wanted."""
    if wanted.design is None:
        return part.faces
    with suppress(InputError):
        return [part.face(word, "") for word in wanted.design]
    return ()


def _to_check(part: Part, wanted: Wanted) -> tuple[int, ...]:
    """Numbers of the faces whose triangles are wanted."""
    with suppress(InputError):
        return tuple(face.number for face in part.to_check(wanted.design or (), wanted.check))
    return ()


def _geometry(known: Known, number: int) -> FaceGeometry:
    """What `PartFace.load` returns or raises, of the faces whose geometry was wanted."""
    return known[number].found()


def _surface(checked: Callable[[], Checked], number: int) -> FaceGeometry:
    """The same of a face that nothing may touch."""
    return _geometry(checked().surfaces, number)


def _triangles(
    checked: Callable[[], Checked], meshing: Meshing, numbers: Sequence[int], deflection: float
) -> list[Piece]:
    """What `Part.triangulate` returns or raises, of the faces whose triangles were wanted."""
    assert (tuple(numbers), deflection) == meshing[:2]
    return checked().triangles.found()
