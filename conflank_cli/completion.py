"""What the shell offers at TAB: files of the kind a command reads, and names of what comes with the program.

Each TAB starts the program anew, so nothing slow to import may be needed here: folders are listed, and no file is read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import click
from click.shell_completion import CompletionItem

Completer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]

PART = (".step", ".stp", ".igs", ".iges", ".brep", ".json")
ARTIFACT = (".npz",)
JOB = (".toml",)
PROGRAM = (".h", ".i", ".apt")
JUDGEMENT = (".verification.json",)
PICTURE = (".png", ".svg", ".pdf")

_PACKAGE = Path(__file__).parent.parent / "postprocessors"
_PORTS = ("ttyUSB*", "ttyACM*", "ttyS*", "cu.*")


def files(*suffixes: str) -> Completer:
    """Offer files whose names end so, and folders on the way to them."""

    def offered(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
        return _files(incomplete, suffixes)

    return offered


def words(known: Iterable[str], *suffixes: str) -> Completer:
    """Offer words, and files with one of the suffixes."""
    known = tuple(known)

    def offered(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
        named = [CompletionItem(word) for word in known if word.startswith(incomplete)]
        # A folder is an answer of last resort: the shell then lists all files.
        return named + (_files(incomplete, suffixes) if suffixes and not named else [])

    return offered


def shipped(*folder: str) -> Completer:
    """Offer what the TOML files of a folder of `postprocessors` are called, and such files of one's own."""
    return words(sorted(path.stem for path in _PACKAGE.joinpath(*folder).glob("*.toml")), ".toml")


def ports(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Offer the serial devices of this computer."""
    found = sorted(str(path) for pattern in _PORTS for path in Path("/dev").glob(pattern))
    return [CompletionItem(name) for name in found if name.startswith(incomplete)] or [
        CompletionItem(incomplete, type="file")
    ]


def _files(incomplete: str, suffixes: tuple[str, ...]) -> list[CompletionItem]:
    """Files and folders that begin as `incomplete` does.

    Where folders are all there is the shell does it itself: it knows that a folder's name is not the end of the word.
    """
    head, slash, start = incomplete.rpartition("/")
    folder = Path(f"{head}{slash}") if slash else Path()
    try:
        entries = sorted(folder.expanduser().iterdir())
    except OSError:
        return []
    names = [entry for entry in entries if entry.name.startswith(start) and (start or not entry.name.startswith("."))]
    found = [entry.name for entry in names if entry.name.lower().endswith(suffixes) and not entry.is_dir()]
    inside = [f"{entry.name}/" for entry in names if entry.is_dir()]
    if not found and inside:
        return [CompletionItem(incomplete, type="file")]
    return [CompletionItem(f"{head}{slash}{name}") for name in sorted([*found, *inside])]
