"""What all posts have in common: the options they get, the programs they return, and how one is found by its format.

A post is a `Post` under the entry-point group ``conflank.postprocessors``; the entry's name is the format's, as
``[program] format`` gives it. A package of somebody else's can bring one along.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from math import isfinite

from postprocessors.errors import PostError
from postprocessors.machines.machine import Machine
from postprocessors.toolpath import ToolPath

GROUP = "conflank.postprocessors"

Shift = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ProgramOptions:
    """How a program is to be written.

    Attributes
    ----------
    version: of the program that writes, for the header.
    style: one of the post's styles.
    datum: number of a preset, or a shift (mm) of the datum from the active preset, from which words then count.
    coolant: "M7" (mist), "M8" (flood) or "none".
    tolerance_mm: how far the control may leave the path (T of cycle 32).
    tolerance_deg: the same for rotary axes; None derives it from `tolerance_mm` and the height of the cutter.
    split: "none" for one program, "sweep" or "tool" for one each and another that calls them.
    own: options that only this post has, by name.
    """

    version: str
    style: str = "tcpm"
    datum: int | Shift = 1
    coolant: str = "M8"
    tolerance_mm: float = 0.002
    tolerance_deg: float | None = None
    split: str = "none"
    own: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ProgramFile:
    """One program: its name on the control, and its text."""

    name: str
    text: str


Write = Callable[[ToolPath, Machine, ProgramOptions], tuple[ProgramFile, ...]]


@dataclass(frozen=True, slots=True)
class Post:
    """A format that programs can be written in.

    Attributes
    ----------
    suffix: of the files, with its dot.
    styles: what ``[program] style`` may be; the first is the default.
    write: the programs of a tool path: the one to run, then those it calls. It writes nothing itself, and raises
        `PostError` for whatever the control or the machine could not execute.
    why: why there are no other styles.
    splits: what ``[program] split`` may be.
    own: names and defaults of the post's own options.
    """

    suffix: str
    styles: tuple[str, ...]
    write: Write
    why: str = ""
    splits: tuple[str, ...] = ("none",)
    own: Mapping[str, str] = field(default_factory=dict)


def post_names() -> tuple[str, ...]:
    """Formats for which a post is installed."""
    return tuple(sorted({entry.name for entry in entry_points(group=GROUP)}))


def post_named(name: str) -> Post:
    """The post for a format.

    Raises
    ------
    PostError: none is installed, or what is installed is none.
    """
    for entry in entry_points(group=GROUP, name=name):
        try:
            post = entry.load()
        except (ImportError, AttributeError) as error:
            raise PostError(
                "[program] format", f"'{name}', whose post does not load ({error})", "a post", _AGAIN
            ) from None
        if not isinstance(post, Post):
            raise PostError("[program] format", f"'{name}', whose post is {entry.value}", "a Post", _AGAIN)
        return post
    known = ", ".join(post_names()) or "a post that is installed"
    raise PostError("[program] format", f"'{name}'", f"one of {known}", "Name one of these, or install its package.")


_AGAIN = "Install the package again that brings it."


def check_options(post: Post, options: ProgramOptions) -> None:
    """Refuse what the post does not have, and values that mean nothing anywhere."""
    choose = "Choose one of these."
    if options.style not in post.styles:
        expected = _listed(post.styles) + (f" ({post.why})" if post.why else "")
        raise PostError("[program] style", f"'{options.style}'", expected, "Choose a style this post can write.")
    if options.split not in post.splits:
        expected = f"{_listed(post.splits)} in this format"
        raise PostError("[program] split", f"'{options.split}'", expected, "Choose another split or format.")
    for key in options.own:
        if key not in post.own:
            known = ", ".join(post.own) or "none in this format"
            raise PostError("[program] options", f"'{key}'", known, "Remove it.")
    if options.coolant not in ("M7", "M8", "none"):
        raise PostError("[program] coolant", f"'{options.coolant}'", "M7, M8 or none", choose)
    if isinstance(options.datum, int):
        if options.datum < 0:
            raise PostError("[program] datum", f"{options.datum}", "a preset number, 0 or more", "Choose a preset.")
    elif len(options.datum) != 3 or not all(isfinite(value) for value in options.datum):
        raise PostError("[program] datum", f"{list(options.datum)}", "a number or three of them", "Correct the shift.")


def own_option(post: Post, options: ProgramOptions, key: str, *known: str) -> str:
    """An option of the post's own, or its default; where `known` is given, one of these."""
    value = options.own.get(key, post.own[key])
    if known and value not in known:
        raise PostError(f"[program] options.{key}", f"'{value}'", _listed(known), "Choose one of these.")
    return value


def _listed(words: tuple[str, ...]) -> str:
    return " or ".join(f"'{word}'" for word in words)
