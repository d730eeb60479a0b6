"""Options and arguments that several commands share, declared once.

=================  =======  =====  ======  ========  ======  ====  ======  ===  ======  ====  ======  ========  ===
option             inspect  reach  detect  optimize  select  post  verify  run  report  plot  export  machines  dnc
=================  =======  =====  ======  ========  ======  ====  ======  ===  ======  ====  ======  ========  ===
FILE, default -       x       x      x        x        x      x      x
FILE...                                                                           x      x      x
JOB                                                                         x
-o, --output                         x        x        x      x      x            x      x      x
--out                                                                       x
--job                                         x        x      x      x
--picture                     x                        x
--json                x       x      x        x        x      x      x      x     x      x      x       x       x
-q -v --debug -h      x       x      x        x        x      x      x      x     x      x      x       x       x
=================  =======  =====  ======  ========  ======  ====  ======  ===  ======  ====  ======  ========  ===

"-" is standard input or standard output. Results go to standard output, everything else to standard error.
"""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import click

from conflank_cli import completion
from conflank_cli.errors import UsageError
from conflank_cli.output import STANDARD
from conflank_cli.progress import Progress, make_progress

Command = Callable[..., Any]


@dataclass(frozen=True, slots=True)
class Talk:
    """What a command says on standard error besides errors."""

    quiet: bool
    verbose: bool
    progress: Progress

    def note(self, text: str) -> None:
        """Say something unless quiet."""
        if not self.quiet:
            click.echo(text, err=True)

    def detail(self, text: str) -> None:
        """Say something if verbose."""
        if self.verbose and not self.quiet:
            click.echo(text, err=True)

    @contextmanager
    def timed(self, title: str) -> Iterator[None]:
        """Say if verbose how long something took."""
        start = time.perf_counter()
        yield
        self.detail(f"{title}: {time.perf_counter() - start:.2f} s")


class NearestGroup(click.Group):
    """A group that names the nearest command there is when it is asked for one that it has not."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that is asked for.

        Raises
        ------
        UsageError: there is none of that name.
        """
        known = self.list_commands(ctx)
        if args and args[0] not in known and not args[0].startswith("-") and not ctx.resilient_parsing:
            near = get_close_matches(args[0], known, n=1)
            raise UsageError(
                ctx.command_path,
                f"no command {args[0]!r}",
                f"one of {', '.join(known)}",
                f"Did you mean {near[0]!r}?" if near else f"{ctx.command_path} --help tells more.",
            )
        return super().resolve_command(ctx, args)


def common(function: Command) -> Command:
    """Add --quiet, --verbose and --debug; the command gets `talk`."""

    @click.option("-q", "--quiet", is_flag=True, help="Say nothing but errors.")
    @click.option("-v", "--verbose", is_flag=True, help="Say more, on standard error.")
    @click.option("--debug", is_flag=True, help="Show where in the program an error came from.")
    @functools.wraps(function)
    def command(quiet: bool, verbose: bool, debug: bool, **arguments: Any) -> Any:
        # The flag itself is read where errors are caught (cli.py): by then this context is gone.
        del debug
        return function(talk=Talk(quiet, verbose, make_progress(quiet)), **arguments)

    return command


def source(metavar: str, *suffixes: str) -> Callable[[Command], Command]:
    """The input file as an argument, standard input if left out; the command gets `source`."""
    return click.argument(
        "source",
        metavar=f"[{metavar}]",
        default=STANDARD,
        callback=_not_from_terminal,
        shell_complete=completion.files(*suffixes),
    )


def sources(*suffixes: str) -> Callable[[Command], Command]:
    """Input files as arguments, one or more; the command gets `sources`."""
    return click.argument(
        "sources", metavar="FILE...", nargs=-1, required=True, shell_complete=completion.files(*suffixes)
    )


def output(what: str, *suffixes: str) -> Callable[[Command], Command]:
    """-o, standard output if left out; the command gets `output`."""
    return click.option(
        "-o",
        "--output",
        metavar="FILE",
        default=STANDARD,
        help=f"Where to write {what}; - or nothing: standard output.",
        shell_complete=completion.files(*suffixes),
    )


def job_override(sections: str) -> Callable[[Command], Command]:
    """--job for later stages; the command gets `job_file`."""
    return click.option(
        "--job",
        "job_file",
        metavar="JOB",
        help=f"Job file that replaces {sections} of the job the input carries.",
        shell_complete=completion.files(*completion.JOB),
    )


def picture(what: str) -> Callable[[Command], Command]:
    """--picture; the command gets `picture`."""
    return click.option(
        "--picture",
        metavar="FILE",
        help=f"Draw {what} to FILE (PNG, SVG or PDF).",
        shell_complete=completion.files(*completion.PICTURE),
    )


as_json = click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output.")


def _not_from_terminal(context: click.Context, parameter: click.Parameter, value: str) -> str:
    """Waiting for somebody to type a CAD file would look like hanging."""
    if value == STANDARD and not context.resilient_parsing and sys.stdin.isatty():
        raise click.UsageError("No input: name a file, or pipe one in.", context)
    return value
