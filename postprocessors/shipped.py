"""TOML files that come with the package, or a user's own: machines and profiles."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from postprocessors.errors import PostError


class TomlText(NamedTuple):
    """The text of a file, and the name it has in messages."""

    content: str
    where: str


def shipped_names(folder: Path) -> tuple[str, ...]:
    """Names of the files in a folder of the package."""
    return tuple(sorted(path.stem for path in folder.glob("*.toml")))


def read_shipped(name_or_path: str | Path, folder: Path, kind: str, expected: str) -> TomlText:
    """Read a file by its name in a folder of the package, or from a path (anything with a folder or ending in .toml).

    `kind` ("machine") and `expected` ("a machine file") are how messages call it.

    Raises
    ------
    PostError: no file of that name, or none that can be read.
    """
    text = str(name_or_path)
    if isinstance(name_or_path, Path) or text.endswith(".toml") or "/" in text or "\\" in text:
        path = Path(name_or_path)
    else:
        path = folder / f"{text}.toml"
        if not path.is_file():
            names = ", ".join(shipped_names(folder))
            raise PostError(kind, f"'{text}'", f"one of {names}", "Name one of these or give the path of a file.")
    try:
        return TomlText(path.read_text("utf-8"), path.name)
    except (OSError, UnicodeDecodeError) as error:
        raise PostError(str(path), f"no readable file ({error})", expected, "Check its path.") from error
