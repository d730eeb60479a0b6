"""`conflank machines`: which machines there are, and whether a machine file is sound."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from conflank_cli import completion, options
from conflank_cli.options import Talk

if TYPE_CHECKING:
    from postprocessors.machines.machine import Machine


@click.group(cls=options.NearestGroup, invoke_without_command=True, epilog="\b\nExample:\n  conflank machines")
@options.as_json
@options.common
@click.pass_context
def machines(context: click.Context, as_json: bool, talk: Talk) -> None:
    """List the machines that come with conflank, or check a machine file.

    A job names one of them under [machine] name, or a file of your own under [machine] file; docs/machines.md says how
    to write one.
    """
    del talk
    if context.invoked_subcommand is not None:
        return
    from conflank_cli.commands.documents import print_document
    from conflank_cli.commands.tables import text_table
    from postprocessors.machines.machine import shipped_machines

    found = [_facts(name) for name in shipped_machines()]
    if as_json:
        print_document({"machines": found})
        return
    rows = [
        (facts["name"], " ".join(facts["axes"]), facts["verified"], len(facts["unknown"]), facts["description"])
        for facts in found
    ]
    click.echo(text_table(["<machine", "<rotary axes", "<verified", "unknown", "<description"], rows), nl=False)


@machines.command(epilog="\b\nExample:\n  conflank machines check ac-table")
@click.argument("name", metavar="NAME|FILE", shell_complete=completion.shipped("machines"))
@options.as_json
@options.common
def check(name: str, as_json: bool, talk: Talk) -> int:
    """Check a machine, shipped or from a file, and tell what it can reach.

    Exit code 1 means that values are still unknown ("?"): they are listed, and no program is posted for the machine.
    """
    from conflank_cli.commands.documents import print_document
    from conflank_cli.commands.tables import cell_text
    from conflank_cli.errors import EXIT_DONE, EXIT_FINDINGS

    facts = _facts(name)
    if as_json:
        print_document(facts)
    else:
        for key, value in facts.items():
            if isinstance(value, list):
                for number, item in enumerate(value):
                    click.echo(f"{key if number == 0 else '':<15} {item}")
            else:
                click.echo(f"{key:<15} {cell_text(value)}")
    if facts["unknown"]:
        talk.note(f"{len(facts['unknown'])} values have to be filled in before a program is posted for it.")
    return EXIT_FINDINGS if facts["unknown"] else EXIT_DONE


def _facts(name: str) -> dict[str, Any]:
    """What a machine file says; of one with unknown values only what can be said."""
    import tomllib

    from postprocessors.machines.machine import parse_machine, read_machine_file, unknown_keys

    content, where = read_machine_file(name)
    unknown = unknown_keys(content, where)
    if unknown:
        tables = tomllib.loads(content)
        return {
            "name": str(tables.get("name", "?")),
            "description": str(tables.get("description", "")),
            "verified": False,
            "axes": [],
            "unknown": list(unknown),
        }
    machine = parse_machine(content, where)
    return {
        "name": machine.name,
        "description": machine.description,
        "verified": machine.verified,
        "axes": [f"{axis.letter} {axis.carried_by}" for axis in machine.rotary],
        "unknown": [],
        **_details(machine),
    }


def _details(machine: Machine) -> dict[str, Any]:
    from postprocessors.kinematics.two_rotary import tilt_all_round

    ranges = [
        f"{axis.letter} endless, {axis.output}"
        if axis.range_deg is None
        else f"{axis.letter} {axis.range_deg[0]:g} .. {axis.range_deg[1]:g} deg"
        for axis in machine.rotary
    ]
    travels = [
        f"{letter} {line.travel_mm[0]:g} .. {line.travel_mm[1]:g} mm"
        for letter, line in zip("XYZ", machine.linear.each, strict=True)
    ]
    return {"ranges": ranges, "travels": travels, "tilt_deg": tilt_all_round(machine)}
