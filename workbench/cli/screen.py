"""What the commands print with: the two consoles, errors, tables, the progress bar."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn
from rich.table import Table
from typer.core import TyperCommand, TyperGroup

import workbench
from workbench.errors import WorkbenchWarning


class _PlainFlags:
    """Help without "<bool>" at every flag."""

    def get_params(self, ctx):
        params = super().get_params(ctx)
        for param in params:
            if getattr(param, "is_flag", False):
                param.metavar = ""
        return params


class Command(_PlainFlags, TyperCommand):
    """A command of the workbench."""


class Group(_PlainFlags, TyperGroup):
    """Commands under one name."""


def with_plain_flags(app: typer.Typer) -> None:
    """Let all commands of an app, and of the groups in it, print their help so."""
    app.info.cls = Group
    for command in app.registered_commands:
        command.cls = Command
    for group in app.registered_groups:
        group.cls = Group
        with_plain_flags(group.typer_instance)


console = Console(highlight=False)
errors = Console(stderr=True, highlight=False)


def print_error(error: Exception | str) -> None:
    """An error, or a sentence of its own, as one line on standard error."""
    errors.print(f"[red]error:[/red] {escape(str(error))}", soft_wrap=True)


def print_note(text: Warning | str) -> None:
    """What a user should know, as one line on standard error."""
    errors.print(f"[yellow]note:[/yellow] {escape(str(text))}", soft_wrap=True)


@contextmanager
def warnings_as_notes() -> Iterator[None]:
    """Print the workbench's own warnings as notes; those of other packages come as ever."""
    shown = warnings.showwarning

    def show(message, category, filename, lineno, file=None, line=None) -> None:
        if issubclass(category, WorkbenchWarning):
            print_note(message)
        else:
            shown(message, category, filename, lineno, file, line)

    warnings.showwarning = show
    try:
        yield
    finally:
        if warnings.showwarning is show:  # else another has taken its place meanwhile, and asks it
            warnings.showwarning = shown


def table(*columns: str, right: tuple[str, ...] = (), whole: tuple[str, ...] = ()) -> Table:
    """An empty table with these columns: numbers in those of `right`, no line breaks in those of `whole`.

    Nothing is cut off: the text of other columns folds.
    """
    made = Table(box=None, pad_edge=False, header_style="bold")
    for name in columns:
        justify = "right" if name in right else "left"
        made.add_column(name, justify=justify, no_wrap=name in (*right, *whole), overflow="fold")
    return made


@contextmanager
def progress_bar(unit: str = "frames/s") -> Iterator[Callable[..., None]]:
    """A bar for the step in progress; yields what tells it `(step, done, total, note="")`. It vanishes at the end.

    Steps may take turns: each keeps its own speed. `unit` is that of its speed; a note stands beside it.
    """
    bar = Progress(
        SpinnerColumn(),
        TextColumn("{task.description:8}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}"),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    with bar:
        tasks = {"warm-up": bar.add_task("warm-up", total=None, rate="", note="")}

        def progress(step: str, done: int, total: int | None, note: str = "") -> None:
            if step not in tasks:
                tasks[step] = bar.add_task(step, total=total, rate="", note="")
            for other in bar.tasks:
                other.visible = other.id == tasks[step]
            speed = bar.tasks[tasks[step]].speed
            rate = f"{speed:.{0 if speed >= 10.0 else 1}f} {unit}" if speed else ""
            bar.update(tasks[step], completed=done, total=total, rate=rate, note=note)

        yield progress


class _HiredWhenNeeded:
    """Workers of this machine that start with their first tasks, and name their dashboard then."""

    said = ""

    def __init__(self, count: int, kind: str):
        self._wanted, self._hired = (count, None, kind), None

    @property
    def count(self) -> int:
        return self._wanted[0] if self._hired is None else self._hired.count

    def start(self) -> None:
        if self._hired is None:
            self._hired = workbench.workers.workers_for(*self._wanted)
            _tell_of(self._hired)

    def results(self, *given) -> Iterator[tuple[int, object]]:
        self.start()
        return self._hired.results(*given)

    def close(self) -> None:
        if self._hired is not None:
            self._hired.close()


@contextmanager
def at_work(count: int, scheduler: str | None, kind: str = "auto") -> Iterator["workbench.workers.Workers"]:
    """The workers of a command (`workbench.workers.workers_for`), which end with it; their dashboard is named.

    A cluster of this machine takes seconds to start, and does so when it is needed: what is wrong with the command is
    told before. A scheduler is there, or not, at once.
    """
    starts = scheduler is None and (count > 1 or kind == "dask")
    workers = _HiredWhenNeeded(count, kind) if starts else workbench.workers.workers_for(count, scheduler, kind)
    try:
        _tell_of(workers)
        yield workers
    finally:
        workers.close()


def _tell_of(workers: "workbench.workers.Workers") -> None:
    if workers.said:
        console.print(workers.said, soft_wrap=True)
