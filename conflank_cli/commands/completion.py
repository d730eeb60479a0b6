"""`conflank completion`: the script that makes a shell complete the program's words."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from conflank_cli import options
from conflank_cli.options import Talk

SHELLS = ("bash", "zsh", "fish")


@click.command(epilog="\b\nExample:\n  conflank completion bash")
@click.argument("shell", type=click.Choice(SHELLS))
@options.common
@click.pass_context
def completion(context: click.Context, shell: str, talk: Talk) -> None:
    """Print the script that completes commands, options and files at TAB.

    \b
    bash   conflank completion bash >> ~/.bashrc
    zsh    conflank completion zsh > ~/.zfunc/_conflank, with ~/.zfunc in fpath before compinit
    fish   conflank completion fish > ~/.config/fish/completions/conflank.fish

    It takes effect in the next shell.
    """
    del talk
    found = get_completion_class(shell)
    assert found is not None
    script = found(context.find_root().command, {}, "conflank", "_CONFLANK_COMPLETE")
    # Not source(): that starts a bash to ask for its version, whichever bash that is.
    click.echo(script.source_template % script.source_vars())
