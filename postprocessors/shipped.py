"""TOML files that come with the package, or a user's own: machines and profiles."""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches
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
            names = shipped_names(folder)
            near = get_close_matches(text, names, n=1)
            step = f"Did you mean {near[0]!r}?" if near else "Name one of these or give the path of a file."
            raise PostError(kind, f"'{text}'", f"one of {', '.join(names)}", step)
    try:
        return TomlText(path.read_text("utf-8"), path.name)
    except (OSError, UnicodeDecodeError) as error:
        raise PostError(str(path), f"no readable file ({error})", expected, "Check its path.") from error


def schema_error(message: str, where: str, known: Iterable[str], expected: str, otherwise: str) -> PostError:
    """What msgspec says of a file whose keys or values are wrong, as a message with the nearest key that there is.

    `where` names the file, `known` are its keys, and `otherwise` is what to do where none of them is near.
    """
    what, _, place = message.partition(" - at `$")
    unknown = re.search(r"unknown field `([^`]*)`", what)
    near = get_close_matches(unknown[1], list(known), n=1) if unknown else []
    return PostError(
        f"{where}: {place.rstrip('`').lstrip('.')}" if place else where,
        f"unknown key {unknown[1]!r}" if unknown else what,
        expected,
        f"Did you mean {near[0]!r}?" if near else otherwise,
    )
