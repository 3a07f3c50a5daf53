"""Packages that come with an extra: one sentence that names it where a package is missing."""

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager

from workbench.errors import MissingDependencyError


def install_command(extra: str) -> str:
    """The command that installs an extra."""
    return f'pip install "face-energy-workbench[{extra}]"'


@contextmanager
def needs(extra: str) -> Iterator[None]:
    """Around imports of packages that come with an extra; raises `MissingDependencyError` where one is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise _missing(error.name or "A package", extra) from error


def check_installed(extra: str, *modules: str) -> None:
    """Raise `MissingDependencyError` unless these modules of an extra can be found; none is imported."""
    for module in modules:
        if importlib.util.find_spec(module) is None:
            raise _missing(module, extra)


def _missing(module: str, extra: str) -> MissingDependencyError:
    return MissingDependencyError(
        f"{module} is not installed; it comes with the extra {extra!r}: {install_command(extra)}."
    )
