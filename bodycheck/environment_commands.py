"""The commands `environments list` and `environments remove`: what was made for engines in other versions."""

from __future__ import annotations

from typing import Annotated

import typer

from bodycheck.errors import InputError

environment_commands = typer.Typer(
    help="List and remove the environments of engines in versions of their own.", no_args_is_help=True
)


@environment_commands.command(name="list", short_help="Print one line per environment.")
def list_() -> None:
    """Print one line per environment: what it is for, its size, from where its packages came, its folder."""
    from bodycheck.adapters.environments import environments

    for found in environments():
        print(f"{found.name}  {found.size / 1e6:.0f} MB  {found.folder}")
        for setting in found.packages_from:
            print(f"    {setting}")


@environment_commands.command(short_help="Remove environments.")
def remove(
    names: Annotated[
        list[str] | None, typer.Argument(help="Like mujoco==3.17.0, as `list` has them.")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Remove all of them.")] = False,
) -> None:
    """Remove environments by name, and print their folders; they are made again when they are needed."""
    from bodycheck.adapters import environments

    if every == bool(names):
        raise InputError("environments remove: give names like mujoco==3.17.0, or --all")
    found = environments.environments()
    unknown = set(names or ()) - {one.name for one in found}
    if unknown:
        known = ", ".join(dict.fromkeys(one.name for one in found)) or "none"
        raise InputError(f"no environment of {', '.join(sorted(unknown))} (available: {known})")
    for one in found:
        if every or one.name in (names or ()):
            try:
                environments.remove(one)
            except OSError as error:
                raise InputError(f"{one.folder}: cannot be removed: {error.strerror or error}") from None
            print(one.folder)
