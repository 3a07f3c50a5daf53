"""`workbench config`: configurations shown, checked, compared, and the schema of their files."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import tomlkit
import typer
from rich.markup import escape
from rich.syntax import Syntax

from workbench.cli import screen
from workbench.config import (
    DEFAULT_PRESET,
    PRESETS,
    VERSION,
    Config,
    config_schema,
    config_toml,
    differences,
    preset,
    read_config,
)
from workbench.config.files import absent_files
from workbench.errors import ConfigError
from workbench.files import atomic_path
from workbench.reading import shortened, toml_tables

GROUP_HELP = """Show, check and compare configurations: the TOML files that `track --config` runs.

[bold]Examples[/bold]

  workbench config show --preset joint > mine.toml    start a file

  workbench config check mine.toml                    can it be run?

  workbench config diff joint mine.toml               what did I change?

  workbench config schema --out config.schema.json    for editors
"""

SHOW_HELP = f"""Print a whole configuration with a comment at each value; what a file leaves out is filled in.

[bold]Examples[/bold]

  workbench config show                                the preset joint, the default

  workbench config show tuned.toml

  workbench config show --preset face-it > mine.toml

Presets: {", ".join(PRESETS)}.
"""

CHECK_HELP = """Check configuration files. Exit code 0: all can be run; 2: some cannot, with the reasons.

[bold]Example[/bold]

  workbench config check tuned.toml out/talk/config.toml
"""

DIFF_HELP = f"""Compare two configurations, files or presets. Exit code 0: equal; 1: different; 2: one cannot be read.

Where a file comes from (its preset, its provenance) is not compared.

[bold]Examples[/bold]

  workbench config diff calibrated tuned.toml

  workbench config diff first.toml second.toml

Presets: {", ".join(PRESETS)}.
"""

SCHEMA_HELP = """Print the JSON Schema of configuration files (draft 2020-12), for completion and checks in an editor.

Editors with TOML support (Even Better TOML, taplo) find it by a first line "#:schema config.schema.json". \
`workbench config check` also checks landmark group names and conflicting values.

[bold]Example[/bold]

  workbench config schema --out config.schema.json
"""

config_app = typer.Typer(no_args_is_help=True, rich_markup_mode="rich", help=GROUP_HELP)


@config_app.command(help=SHOW_HELP)
def show(
    file: Annotated[Path | None, typer.Argument(help="Configuration file (TOML).")] = None,
    preset_name: Annotated[str | None, typer.Option("--preset", help=f"One of: {', '.join(PRESETS)}.")] = None,
) -> None:
    """Print a whole configuration."""
    if file is not None and preset_name is not None:
        raise ConfigError("Give a file or --preset, not both; a configuration file names its preset itself.")
    _print_text(config_toml(read_config(file) if file is not None else preset(preset_name or DEFAULT_PRESET)), "toml")


@config_app.command(help=CHECK_HELP)
def check(files: Annotated[list[Path], typer.Argument(help="Configuration files (TOML).")]) -> None:
    """Check configuration files."""
    failed = False
    for file in files:
        try:
            told = f"[green]OK[/green]     {escape(f'{file}: {_described(file)}')}"
        except ConfigError as error:
            failed = True
            told = f"[red]ERROR[/red]  {escape(str(error))}"
        screen.console.print(told, soft_wrap=True)
    raise typer.Exit(2 if failed else 0)


@config_app.command(help=DIFF_HELP)
def diff(
    first: Annotated[str, typer.Argument(metavar="A", help="Configuration file or preset.")],
    second: Annotated[str, typer.Argument(metavar="B", help="Configuration file or preset.")],
) -> None:
    """Compare two configurations."""
    found = differences(_file_or_preset(first), _file_or_preset(second))
    if not found:
        screen.console.print("no differences")
        return
    table = screen.table("path", escape(first), escape(second), whole=("path",))
    for item in found:
        table.add_row(*(escape(cell) for cell in (item.path, _as_toml(item.before), _as_toml(item.after))))
    screen.console.print(table)
    raise typer.Exit(1)


@config_app.command(help=SCHEMA_HELP)
def schema(out: Annotated[Path | None, typer.Option(help="File to write instead of printing.")] = None) -> None:
    """Print the JSON Schema of configuration files."""
    if out is None:
        _print_text(config_schema(), "json")
        return
    with atomic_path(out) as temporary:
        temporary.write_text(config_schema(), encoding="utf-8")
    screen.console.print(escape(str(out)), soft_wrap=True)


def _print_text(text: str, language: str) -> None:
    """Text for a file or a program as it is, in UTF-8; highlighted for a terminal."""
    if screen.console.is_terminal:
        highlighted = Syntax("", language, theme="ansi_dark").highlight(text)
        screen.console.print(highlighted, soft_wrap=True, end="")
    else:
        typer.echo(text.encode(), nl=False)


def _described(file: Path) -> str:
    """Preset, version and distance from the preset. Raises `ConfigError` for a file that cannot be run."""
    config = read_config(file)
    for setting, name in absent_files(config).items():
        raise ConfigError(
            f"{file}: {setting} names {shortened(repr(name))}, which does not exist here; run it from the folder that "
            "holds it, or give the full path."
        )
    stored = toml_tables(file, ConfigError).get("version", VERSION)
    version = f"version {stored}" if stored == VERSION else f"version {stored}, migrated to version {VERSION}"
    changed = len(differences(preset(config.preset), config))
    return f"preset {config.preset}, {version}, {_count(changed, 'difference')} from the preset"


def _count(number: int, noun: str) -> str:
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"


def _file_or_preset(name: str) -> Config:
    if name in PRESETS:
        return preset(name)
    if not os.path.exists(name):
        told = shortened(repr(name))
        raise ConfigError(f"There is neither a file nor a preset {told}; the presets are {', '.join(PRESETS)}.")
    return read_config(name)


def _as_toml(value: Any) -> str:
    """A value as a configuration file has it; a dash for one that is not there."""
    if value is None:
        return "–"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name} = {_as_toml(entry)}" for name, entry in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(_as_toml(entry) for entry in value) + "]"
    return tomlkit.item(value).as_string()
