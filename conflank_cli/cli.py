"""The command line: the group of commands, and what a user sees when something goes wrong."""

from __future__ import annotations

import atexit
import gc
import io
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from importlib import import_module
from typing import Any

import click

from conflank_cli import __version__
from conflank_cli.errors import EXIT_DEVICE, EXIT_DONE, EXIT_INPUT, EXIT_NUMERICAL, EXIT_USAGE, ConflankError
from conflank_cli.options import NearestGroup
from conflank_cli.output import done_so_far, forget_done
from postprocessors.errors import DeviceError, Interrupted, PostError

# What a shell reports for a program that SIGINT or SIGPIPE ended.
EXIT_INTERRUPTED = 130
EXIT_BROKEN_PIPE = 141
OBJECTS_BEFORE_COLLECTION = 300_000

COMMANDS = {
    "inspect": "conflank_cli.commands.inspect_:inspect",
    "reach": "conflank_cli.commands.reach:reach",
    "detect": "conflank_cli.commands.detect:detect",
    "optimize": "conflank_cli.commands.optimize:optimize",
    "select": "conflank_cli.commands.select:select",
    "post": "conflank_cli.commands.post:post",
    "verify": "conflank_cli.commands.verify:verify",
    "machines": "conflank_cli.commands.machines:machines",
    "dnc": "conflank_cli.commands.dnc:dnc",
    "run": "conflank_cli.commands.run:run",
    "report": "conflank_cli.commands.report:report",
    "plot": "conflank_cli.commands.plot:plot",
    "export": "conflank_cli.commands.export:export",
    "completion": "conflank_cli.commands.completion:completion",
}
"""Commands in the order of the pipeline, as module:attribute. A command module imports numerics only when it runs."""


class LazyGroup(NearestGroup):
    """A group that imports a command when it is needed and words errors in three parts."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands in the order of the pipeline."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name, imported now."""
        if cmd_name not in COMMANDS:
            return None
        module, _, attribute = COMMANDS[cmd_name].partition(":")
        command = getattr(import_module(module), attribute)
        assert isinstance(command, click.Command)
        return command

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; a reader that left the pipe is no error to speak of."""
        try:
            result = super().invoke(ctx)
            sys.stdout.flush()
            return result
        except BrokenPipeError:
            # Python flushes stdout once more at exit, and would complain then.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            ctx.exit(EXIT_BROKEN_PIPE)

    def main(self, args: Sequence[str] | None = None, standalone_mode: bool = True, **extra: Any) -> Any:  # type: ignore[override]
        """Run, print errors, and exit with the code that the contract names."""
        arguments = list(sys.argv[1:] if args is None else args)
        extra["prog_name"] = "conflank"
        run = super().main
        if not standalone_mode:
            return run(arguments, standalone_mode=False, **extra)
        sys.exit(
            _guarded(lambda: run(arguments, standalone_mode=False, **extra), debug="--debug" in arguments),
        )


def _guarded(run: Callable[[], Any], debug: bool) -> int:
    """Run, and turn whatever happens into one message and an exit code."""
    forget_done()
    try:
        code = run()
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return EXIT_USAGE
    except click.ClickException as error:
        _say_usage(error)
        return EXIT_USAGE
    except (click.Abort, KeyboardInterrupt) as error:
        return _interrupted(error)
    except (ConflankError, PostError) as error:
        if debug:
            traceback.print_exc()
        _say(error.where, error.found, error.expected, error.next_step)
        if isinstance(error, ConflankError):
            return error.exit_code
        return EXIT_DEVICE if isinstance(error, DeviceError) else EXIT_INPUT
    except OSError as error:
        if debug:
            traceback.print_exc()
        where = "standard output" if error.filename is None else str(error.filename)
        _say(where, error.strerror or str(error), "a file that can be read and written", "Check the file and its disk.")
        # Python flushes stdout once more at exit, and would complain then.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_USAGE
    except Exception as error:
        if _came_of_interrupt(error):
            return _interrupted(error)
        if debug:
            traceback.print_exc()
        text = " ".join(str(error).split()) or "no further word"
        _say(
            "conflank itself",
            f"{type(error).__name__}: {text}",
            "no error of the program's own",
            "Run it again with --debug, and report what it prints together with the job.",
        )
        return EXIT_NUMERICAL
    return code if isinstance(code, int) else EXIT_DONE


def _interrupted(error: BaseException) -> int:
    """Say what was done until then, of files and of what a control has received."""
    done = done_so_far()
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, Interrupted):
            done.append(cause.text)
            break
        cause = cause.__cause__ or cause.__context__
    click.echo(f"Interrupted: {'; '.join(done) or 'nothing was written'}.", err=True)
    return EXIT_INTERRUPTED


def _came_of_interrupt(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind an error: a module that is being loaded makes an ImportError of it."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def _say_usage(error: click.ClickException) -> None:
    """What is wrong with the words of the command line; the nearest option where one is not known."""
    context: click.Context | None = getattr(error, "ctx", None)
    path = context.command_path if context else "conflank"
    usage = " ".join([path, *context.command.collect_usage_pieces(context)]) if context else "another call"
    more = f"{path} --help tells more."
    if isinstance(error, click.NoSuchOption):
        options = [name for each in context.command.get_params(context) for name in each.opts] if context else []
        near = get_close_matches(error.option_name, options, n=1)
        step = f"Did you mean {near[0]}?" if near else more
        _say(path, f"no option {error.option_name}", "an option of the command", step)
        return
    parameter: click.Parameter | None = getattr(error, "param", None)
    if isinstance(error, click.MissingParameter) and parameter is not None:
        _say(path, f"no {_called(parameter)}", usage, more)
    elif isinstance(error, click.BadParameter) and parameter is not None:
        found, _, _ = error.message.partition(" is not ")
        near = get_close_matches(found.strip("'"), getattr(parameter.type, "choices", ()), n=1)
        step = f"Did you mean {near[0]!r}?" if near else more
        _say(f"{path}: {_called(parameter)}", found.rstrip("."), _wanted(parameter.type), step)
    else:
        _say(path, error.format_message().rstrip("."), usage, more)


def _called(parameter: click.Parameter) -> str:
    """What a user calls an option or argument."""
    if isinstance(parameter, click.Option):
        return max(parameter.opts, key=len)
    return (parameter.metavar or parameter.name or "").upper().strip("[]")


def _wanted(kind: click.ParamType[Any]) -> str:
    """The values that a parameter takes."""
    if isinstance(kind, click.Choice):
        return f"one of {', '.join(map(str, kind.choices))}"
    if isinstance(kind, click.IntRange | click.FloatRange):
        return f"{kind.name.removesuffix(' range')} from {kind.min} to {kind.max}"
    return f"a value of type {kind.name}"


def _say(where: str, found: str = "", expected: str = "", next_step: str = "") -> None:
    """Print one message: where, found against expected, next step."""
    lines = [f"error: {where}"]
    lines += [
        f"  {name:<9} {text}" for name, text in (("found", found), ("expected", expected), ("next", next_step)) if text
    ]
    click.echo("\n".join(lines), err=True)


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="\b\nExample:\n  conflank run job.toml --out out",
)
@click.version_option(__version__)
def cli() -> None:
    """Programs for flank milling of blades with conical tools.

    From a CAD part and a job file to a HEIDENHAIN program that has been read back and measured. Each stage reads the
    file before it and writes its own; a file left out, or -, is standard input or output:

    \b
      conflank detect job.toml | conflank optimize | conflank select | conflank post > BLADE.H

    Exit codes: 0 done, 1 valid run with findings, 2 usage, 3 bad input file, 4 numerical failure, 5 device.
    """


def main() -> None:
    """Entry point of the command `conflank`."""
    # What is imported, 200000 objects, stays to the end. To look through it for garbage time and again, and once more
    # when the process ends, would take a quarter of a second.
    gc.set_threshold(OBJECTS_BEFORE_COLLECTION)
    atexit.register(gc.freeze)
    # Threads are for stages. Those of OpenBLAS would only be in the way, on systems of a few hundred unknowns; and with
    # one the rounding is the same on any number of cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # A terminal that has no rule or µ shows a question mark for it.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    cli.main()
