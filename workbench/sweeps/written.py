"""What a sweep leaves in its folder in addition to the results: tables, figures, the best configuration."""

from collections.abc import Sequence
from fnmatch import fnmatch
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from workbench import __version__
from workbench.config import Config, config_toml
from workbench.config.sections import Provenance
from workbench.files import make_folder, writing
from workbench.objectives import WeightedSum
from workbench.sweeps.figures import FIGURES, write_figures
from workbench.sweeps.outcome import SweepResult
from workbench.sweeps.storage import is_url

TABLE, BEST = "table.csv", "best.toml"


def write_outcome(result: SweepResult, place: str | Path, wanted: WeightedSum | None = None) -> tuple[str, ...]:
    """Write the tables, the figures and the best configuration; returns the names of the files.

    `wanted` is what the best point minimises; None: the first objective. `table.parquet` needs pyarrow. Raises
    `OutputError` if nothing more can be written there.
    """
    if not is_url(str(place)):
        there = [path.name for path in make_folder(place).iterdir()]
        names = _write(result, Path(place), wanted)
        for earlier in _outdated(there, names):
            (Path(place) / earlier).unlink(missing_ok=True)
        return names
    import fsspec

    with TemporaryDirectory() as folder:
        names = _write(result, Path(folder), wanted)
        system, path = fsspec.core.url_to_fs(str(place))
        with writing(place):
            there = [Path(each).name for each in system.ls(path, detail=False)] if system.exists(path) else []
            for name in names:
                system.put_file(str(Path(folder) / name), f"{path.rstrip('/')}/{name}")
            for earlier in _outdated(there, names):
                system.rm_file(f"{path.rstrip('/')}/{earlier}")
    return names


def _outdated(there: Sequence[str], written: Sequence[str]) -> list[str]:
    """Of what was there, figures and best configuration of an earlier outcome; nothing without its table."""
    if TABLE not in there:
        return []
    return [name for name in there if name not in written and any(fnmatch(name, each) for each in (BEST, *FIGURES))]


def _write(result: SweepResult, folder: Path, wanted: WeightedSum | None) -> tuple[str, ...]:
    wanted = wanted or WeightedSum({result.objectives[0]: 1.0})
    names = [TABLE]
    result.write_csv(folder / TABLE)
    if find_spec("pyarrow"):
        result.write_parquet(folder / "table.parquet")
        names.append("table.parquet")
    best = result.best(wanted)
    if best is not None:
        with writing(folder / BEST):
            (folder / BEST).write_text(config_toml(best_config(result, best)), encoding="utf-8")
        names.append(BEST)
    if result.values:
        with writing(folder):
            names.extend(write_figures(result, folder))
    return tuple(names)


def best_config(result: SweepResult, number: int) -> Config:
    """The configuration of a point, with where it comes from."""
    settings = [f"{path} = {value}" for path, value in result.points[number].values]
    provenance = Provenance(
        versions={"workbench": __version__},
        inputs=list(result.clips),
        changed=settings,
        after={name: float(result.means(name)[number]) for name in result.objectives},
    )
    return result.config(number).model_copy(update={"provenance": provenance})
