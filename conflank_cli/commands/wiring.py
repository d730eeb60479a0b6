"""Which port and with which settings: the options that the dnc commands share."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from conflank_cli import completion
from conflank_cli.options import Command

if TYPE_CHECKING:
    from postprocessors.dnc.profile import Profile

DEFAULT_PROFILE = "itnc530-standard"


@dataclass(frozen=True, slots=True)
class Wiring:
    """Which port, with which settings, and where what goes over it is noted."""

    profile: Profile
    port: str
    log: str | None
    as_hex: bool


def wiring(function: Command) -> Command:
    """Add --profile, --port, --set, --log and --hex; the command gets `wiring`."""

    @click.option(
        "--profile",
        "profile_name",
        metavar="NAME",
        default=DEFAULT_PROFILE,
        show_default=True,
        help="Shipped profile, or a TOML file.",
        shell_complete=completion.shipped("dnc", "profiles"),
    )
    @click.option(
        "--port",
        metavar="PORT",
        help="Device or pyserial URL, instead of the profile's.",
        shell_complete=completion.ports,
    )
    @click.option(
        "--set", "changes", metavar="KEY=VALUE", multiple=True, help="Another value for a key of the profile."
    )
    @click.option("--log", metavar="FILE", help="Note everything that goes over the wire.")
    @click.option("--hex", "as_hex", is_flag=True, help="Note it in hexadecimal.")
    @functools.wraps(function)
    def command(
        profile_name: str, port: str | None, changes: tuple[str, ...], log: str | None, as_hex: bool, **arguments: Any
    ) -> Any:
        profile = read_profile(profile_name, changes)
        return function(wiring=Wiring(profile, port or profile.port, log, as_hex), **arguments)

    return command


def read_profile(name: str, changes: tuple[str, ...]) -> Profile:
    """A profile with what --set changes in it."""
    from postprocessors.dnc.profile import load_profile

    pairs = {}
    for change in changes:
        key, equals, value = change.partition("=")
        if not equals:
            raise click.BadParameter(f"{change!r} is not KEY=VALUE.", param_hint="--set")
        pairs[key.strip()] = value.strip()
    return load_profile(name, pairs)
