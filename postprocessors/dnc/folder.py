"""Programs in files: a folder that is served, one program that is sent, one that is received."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from postprocessors.dnc.blockwise import NAME_PATTERN
from postprocessors.dnc.profile import Profile
from postprocessors.dnc.program import Program, ends_program, name_in, read_program
from postprocessors.dnc.store import Entry, Refusal, Sink
from postprocessors.errors import DeviceError, PostError

EXTENSIONS = {"H": ".H", "D": ".I", "I": ".I", "T": ".T", "P": ".P", "A": ".A"}
"""What a control leaves out of a name, by its letter for the type: conversational, ISO, tools, pallets, text."""
JUDGEMENT = ".verification.json"
Gate = Callable[[Path, str], str | None]
"""Why a program must not be sent, from its file and the SHA-256 of what would be sent; None if it may."""


def same_name(one: str, other: str) -> bool:
    """Whether two names mean one program: case does not matter, nor an extension that one of them lacks."""
    one, other = one.upper(), other.upper()
    return one == other or (("." in one) != ("." in other) and one.partition(".")[0] == other.partition(".")[0])


def is_judgement(name: str) -> bool:
    """Whether a name is that of a verification, on any file system.

    Some do not tell capitals, and drop full stops and spaces at the end.
    """
    return name.rstrip(". ").lower().endswith(JUDGEMENT)


class FileSink:
    """A file that is arriving, hidden beside its final name until it is complete.

    It holds one program: a second one in the same transfer, or text after the end, is an error, because nobody has
    asked for it. `expected` is the name that its first line must give, if that line gives any. What arrives never gets
    the name of a verification, which only `conflank verify` may write.
    """

    def __init__(self, path: Path, overwrite: bool, expected: str = "") -> None:
        self._path = path
        self._overwrite = overwrite
        self._expected = expected
        if is_judgement(path.name):
            raise PostError(str(path), "the name of a verification", "another name", "Name the file differently.")
        try:
            handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
        except OSError as error:
            raise PostError(str(path), f"{error.strerror}", "a folder that can be written", "Name another.") from None
        self._temporary = Path(name)
        self._stream = os.fdopen(handle, "wb")
        self._program: str | None = None
        self._ended = False

    def write(self, line: bytes) -> None:
        """Add a line, given without its end."""
        self._check_line(line)
        with self._on_disk():
            self._stream.write(line + b"\r\n")

    def _check_line(self, line: bytes) -> None:
        where, expected = f"receiving {self._path.name}", "one program in one transfer"
        name = name_in(line)
        if name is not None:
            if self._program is not None:
                found = f"program {name} after program {self._program}"
                raise DeviceError(where, found, expected, "Output each by itself at the control.")
            self._program = name
            if self._expected and not same_name(name, self._expected):
                where, expected = f"receiving {self._expected}", f"program {self._expected}"
                raise DeviceError(where, f"program {name} from the control", expected, "Choose it at the control.")
        elif self._ended and line.strip():
            found = f"text after the end of program {self._program}: {line.decode('latin-1').strip()[:40]}"
            raise DeviceError(where, found, expected, "Output the program again, or mend it at the control.")
        self._ended |= self._program is not None and ends_program(line)

    def commit(self) -> None:
        """Give the file its name."""
        with self._on_disk():
            self._stream.flush()
            os.fsync(self._stream.fileno())
            self._stream.close()
            self._temporary.chmod(0o644)
            if self._overwrite:
                self._temporary.replace(self._path)
            else:
                self._name_if_free()

    def _name_if_free(self) -> None:
        try:
            # Unlike a rename, a link fails where a file of that name has appeared in the meantime.
            self._path.hardlink_to(self._temporary)
            self._temporary.unlink()
        except FileExistsError:
            self._temporary.unlink()
            raise Refusal("FILE EXISTS", f"{self._path.name} exists by now") from None
        except OSError:
            # A file system without links, such as that of a memory stick.
            if os.path.lexists(self._path):
                self._temporary.unlink()
                raise Refusal("FILE EXISTS", f"{self._path.name} exists by now") from None
            self._temporary.replace(self._path)

    @contextmanager
    def _on_disk(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            found, expected = f"{error.strerror}", "room for the program"
            raise DeviceError(str(self._path), found, expected, "Make room, or name another folder.") from error

    def discard(self) -> None:
        """Leave nothing behind."""
        with suppress(OSError):
            self._stream.close()
        self._temporary.unlink(missing_ok=True)


class OneProgram:
    """A store with nothing but the program that is sent."""

    def __init__(self, program: Program) -> None:
        self._program = program

    def directory(self) -> list[Entry]:
        """That program."""
        return [Entry(self._program.path.name, self._program.size)]

    def read(self, name: str, kind: str) -> Iterator[bytes]:
        """Its lines, if it is the one that is asked for, or none is."""
        names = (self._program.path.name, self._program.name)
        if name and not any(same_name(name, own) for own in names):
            raise Refusal("FILE NOT FOUND", f"the control asks for {name}, not for {self._program.name}")
        return self._program.text()

    def create(self, name: str, kind: str) -> Sink:
        """Nothing is received while one waits to send."""
        raise Refusal("NOT EXPECTED", f"the control wants to output {name}, not to read {self._program.name}")


class OneFile:
    """A store that only takes the program that is received."""

    def __init__(self, name: str, path: Path, overwrite: bool) -> None:
        self._name, self._path, self._overwrite = name, path, overwrite

    def directory(self) -> list[Entry]:
        """Nothing."""
        return []

    def read(self, name: str, kind: str) -> Iterator[bytes]:
        """Nothing is sent while one waits to receive."""
        raise Refusal("NOT EXPECTED", f"the control wants to read {name or 'all files'}, not to output {self._name}")

    def create(self, name: str, kind: str) -> Sink:
        """The file, if its name is the one that is waited for."""
        if name and not same_name(name, self._name):
            raise Refusal("WRONG NAME", f"the control outputs {name}, not {self._name}")
        return FileSink(self._path, self._overwrite)


class Folder:
    """The files of one folder; those below it, and links that lead out of it, do not exist for a control."""

    def __init__(
        self, path: Path, profile: Profile, gate: Gate, writable: bool = True, overwrite: bool = False
    ) -> None:
        self._path = path
        self._profile = profile
        self._gate = gate
        self._writable = writable
        self._overwrite = overwrite

    def _files(self) -> list[Path]:
        inside = self._path.resolve()
        files = [path for path in sorted(self._path.iterdir()) if re.fullmatch(NAME_PATTERN, path.name)]
        return [path for path in files if _target(path, inside) is not None]

    def directory(self) -> list[Entry]:
        """Every file with a legal name."""
        return [Entry(path.name, path.stat().st_size) for path in self._files()]

    def refusal(self, name: str) -> str | None:
        """Why the file of a name would not be sent; None if it would."""
        try:
            self._program(name, "")
        except Refusal as refusal:
            return refusal.reason
        return None

    def read(self, name: str, kind: str) -> Iterator[bytes]:
        """The program of that name, if it may be sent."""
        return self._program(name, kind).text()

    def _program(self, name: str, kind: str) -> Program:
        path = self._find(name, kind)
        # The target is what is read: a link that is turned elsewhere in the meantime leads nowhere.
        target = None if path is None else _target(path, self._path.resolve())
        if path is None or target is None:
            raise Refusal("FILE NOT FOUND", f"there is no {name} in {self._path}")
        try:
            program = read_program(target, self._profile, follow=False)
        except PostError as error:
            raise Refusal("FILE NOT READABLE", str(error)) from error
        # What was read is what is sent, so its hash decides and not the file's of a moment later.
        if reason := self._gate(path, program.sha256):
            raise Refusal("NOT VERIFIED", reason)
        return program

    def create(self, name: str, kind: str) -> Sink:
        """A new file."""
        # Some file systems drop a full stop at the end: the name would be another one.
        if not re.fullmatch(NAME_PATTERN, name) or name.endswith("."):
            raise Refusal("ILLEGAL NAME", f"{name!r} is no legal name")
        if is_judgement(name):
            raise Refusal("ILLEGAL NAME", f"{name} was not written: no control writes verifications")
        if not self._writable:
            raise Refusal("READ ONLY", f"{name} was not written: the folder is served for reading")
        existing = self._find(name, kind)
        if existing is not None and not self._overwrite:
            raise Refusal("FILE EXISTS", f"{existing.name} exists and is not replaced without --overwrite")
        path = existing or self._path / (name if "." in name else name + EXTENSIONS.get(kind, ""))
        if os.path.lexists(path) and existing is None:
            raise Refusal("FILE EXISTS", f"{path.name} is something else than a file")
        try:
            return FileSink(path, self._overwrite)
        except PostError as error:
            raise Refusal("CANNOT WRITE", str(error)) from error

    def _find(self, name: str, kind: str) -> Path | None:
        """The file that is meant; the exact name goes first, then without regard to case."""
        wanted = name if "." in name else name + EXTENSIONS.get(kind, "")
        files = {path.name: path for path in self._files()}
        for candidate in (wanted, name):
            if candidate in files:
                return files[candidate]
        for candidate in (wanted, name):
            for own, path in files.items():
                if own.upper() == candidate.upper():
                    return path
        return None


def _target(path: Path, inside: Path) -> Path | None:
    """The file behind a name, through links; None unless it is a file of the folder and no verification."""
    target = path.resolve()
    if target.parent != inside or is_judgement(path.name) or is_judgement(target.name) or not target.is_file():
        return None
    return target
