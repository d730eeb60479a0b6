"""`conflank dnc simulate`: a control to try settings and scripts with."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from conflank_cli import completion, options
from conflank_cli.commands.wiring import DEFAULT_PROFILE, read_profile
from conflank_cli.options import Talk

if TYPE_CHECKING:
    from postprocessors.dnc.simulated_control import Faults, SimulatedControl

ACTIONS = ("load=NAME", "save=NAME", "load-all", "save-all", "directory", "fe1-directory")


@click.command(epilog="\b\nExample:\n  conflank dnc simulate save=BLADE1.H --link ./tnc")
@click.argument(
    "actions",
    metavar="ACTION...",
    nargs=-1,
    required=True,
    shell_complete=completion.words(word.removesuffix("NAME") for word in ACTIONS),
)
@click.option(
    "--profile",
    "profile_name",
    metavar="NAME",
    default=DEFAULT_PROFILE,
    show_default=True,
    help="As for send.",
    shell_complete=completion.shipped("dnc", "profiles"),
)
@click.option("--set", "changes", metavar="KEY=VALUE", multiple=True, help="Another value for a key of the profile.")
@click.option("--link", metavar="FILE", help="Name under which the port is found, besides its own.")
@click.option(
    "--memory",
    metavar="DIR",
    type=click.Path(),
    default=".",
    show_default=True,
    help="Folder with the control's programs.",
)
@click.option(
    "--fault", "faults", metavar="KEY=VALUE", multiple=True, help="Something that goes wrong: see docs/dnc.md."
)
@click.option("--wait", metavar="SECONDS", default=0.0, help="How long to wait for a program at the port; 0: for ever.")
@click.option(
    "--linger", metavar="SECONDS", default=30.0, show_default=True, help="How long to leave the port at the end."
)
@options.as_json
@options.common
def simulate(
    actions: tuple[str, ...],
    profile_name: str,
    changes: tuple[str, ...],
    link: str | None,
    memory: str,
    faults: tuple[str, ...],
    wait: float,
    linger: float,
    as_json: bool,
    talk: Talk,
) -> int:
    """Simulate a control at a pseudo-terminal.

    Prints the name of the port, waits until a program opens it, and then does what an operator would: load=NAME reads
    a program into the control, save=NAME outputs one; load-all, save-all, directory and fe1-directory work blockwise.
    Rate and handshake by characters are as on a line; parity and RTS/CTS cannot be simulated.
    """
    from conflank_cli.errors import EXIT_DEVICE, EXIT_DONE
    from postprocessors.dnc.simulated_control import Setup, SimulatedControl
    from postprocessors.dnc.simulated_port import PseudoTerminal

    profile = read_profile(profile_name, changes)
    setup = Setup(
        blockwise=profile.blockwise,
        character_s=profile.character_s,
        dc3=profile.dc3,
        bcc_no_control=profile.bcc_no_control,
        line_end_in_block=profile.line_end_in_block,
    )
    control = SimulatedControl(setup, FolderMemory(Path(memory)), _faults(faults))
    steps = [_step(control, action) for action in actions]
    terminal = PseudoTerminal(Path(link) if link is not None else None)
    good = True
    done: list[dict[str, Any]] = []
    try:
        # Whoever opens the port has to know its name before there is anything to tell.
        click.echo(terminal.name, err=as_json)
        for action, step in zip(actions, steps, strict=True):
            if not terminal.wait_for_program(wait):
                talk.note(f"{action}: nobody has opened the port")
                return EXIT_DEVICE
            terminal.run(control, step)
            if not as_json:
                click.echo(f"{action}: {control.screen}{_rate(control)}")
            good &= control.succeeded
            done.append(
                {
                    "action": action,
                    "screen": control.screen,
                    "succeeded": control.succeeded,
                    "characters": control.received,
                    "seconds": round(max(control.last_at - control.first_at, 0.0), 3),
                }
            )
            if control.vanished:
                break
        else:
            terminal.wait_for_end(linger)
    finally:
        terminal.close()
    if as_json:
        from conflank_cli.commands.documents import print_document

        print_document({"port": terminal.name, "actions": done})
    return EXIT_DONE if good else EXIT_DEVICE


def _rate(control: SimulatedControl) -> str:
    """How much of the line's rate was used while characters arrived."""
    seconds = control.last_at - control.first_at
    if seconds <= 0.0:
        return ""
    share = (control.received - 1) * control.setup.character_s / seconds
    return f" ({control.received} characters received in {seconds:.3f} s, {100.0 * share:.1f} % of the line)"


def _step(control: SimulatedControl, action: str) -> Any:
    """What the operator does, as a function of the time."""
    word, equals, name = action.partition("=")
    if word in ("load", "save") and name:
        if word == "save" and name not in control.memory:
            raise click.BadParameter(f"there is no {name} in --memory.", param_hint="save")
        return lambda now: getattr(control, word)(name, now)
    if f"{word}{equals}" in ACTIONS and word not in ("load", "save"):
        return lambda now: getattr(control, word.replace("-", "_"))(now)
    raise click.BadParameter(f"{action!r} is none of {', '.join(ACTIONS)}.", param_hint="ACTION")


def _faults(words: tuple[str, ...]) -> Faults:
    """Faults from KEY=VALUE; block numbers with commas, "block:times" or "block:seconds" where there are two."""
    from dataclasses import fields

    from postprocessors.dnc.simulated_control import Faults

    kinds = {field.name: str(field.type) for field in fields(Faults)}
    values: dict[str, Any] = {}
    for word in words:
        key, _, text = word.partition("=")
        if key not in kinds:
            raise click.BadParameter(f"{key!r} is none of {', '.join(kinds)}.", param_hint="--fault")
        kind = kinds[key]
        try:
            if kind.startswith("dict"):
                number = int if "int, int" in kind else float
                pairs = [part.split(":") for part in text.split(",")]
                values[key] = {int(block): number(value) for block, value in pairs}
            elif kind.startswith("frozenset"):
                values[key] = frozenset(int(part) for part in text.split(","))
            elif kind == "bool":
                values[key] = text in ("", "true", "1")
            else:
                values[key] = {"int": int, "float": float, "str": str}[kind](text)
        except ValueError:
            raise click.BadParameter(f"{word!r}: {kind} expected.", param_hint="--fault") from None
    return Faults(**values)


class FolderMemory(MutableMapping[str, bytes]):
    """The control's programs as files of a folder; a new one appears when it is complete."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __getitem__(self, name: str) -> bytes:
        try:
            return (self._folder / name).read_bytes()
        except OSError:
            raise KeyError(name) from None

    def __setitem__(self, name: str, program: bytes) -> None:
        from conflank_cli.output import write_output

        write_output(program, self._folder / name)

    def __delitem__(self, name: str) -> None:
        (self._folder / name).unlink()

    def __iter__(self) -> Iterator[str]:
        return (path.name for path in sorted(self._folder.iterdir()) if path.suffix in (".H", ".I"))

    def __len__(self) -> int:
        return sum(1 for _ in self)
