"""Which settings act on the fits of a sweep or a search: those to landmarks that were found once, before all fits."""

from collections.abc import Iterator, Mapping

from workbench.config import Config, preset
from workbench.errors import ConfigError
from workbench.sweeps.results import UNREAD
from workbench.sweeps.space import Axis

BEFORE_LANDMARKS = {"landmarks.detector", "landmarks.face", "landmarks.face_landmarker", "camera.rig"}
OF_FOV = {"camera.fov_deg", "camera.fov_known"}
REPLACED_BY_RIG = OF_FOV | {"camera.matrix", "camera.distortion"}
FIXED = UNREAD - {"preset"} | {"system"}


def check_axis(axis: Axis, base: Config) -> None:
    """Raise `ConfigError` for a setting that does not act on fits to landmarks which `base` has found."""
    if axis.path == "preset":
        _check_presets(axis, base)
    for path in _paths(axis):
        if path in BEFORE_LANDMARKS:
            raise ConfigError(
                f"{path!r} cannot be varied: landmarks are found once per clip, before all fits; start from another "
                "value with --preset or --config."
            )
        if (section := path.split(".")[0]) in FIXED:
            raise ConfigError(f"{path!r} has no effect here: fits to landmarks do not read {section!r}; leave it out.")
        if path in REPLACED_BY_RIG and base.camera.rig:
            raise ConfigError(f"{path!r} has no effect with a rig, which holds the lens (camera.rig); leave it out.")
        if path in OF_FOV and base.camera.matrix is not None:
            raise ConfigError(f"{path!r} has no effect with a camera's matrix (camera.matrix, --rig).")


def _paths(axis: Axis) -> Iterator[str]:
    """The settings that an axis sets; those of a whole section one by one."""
    if "." in axis.path:
        yield axis.path
        return
    tables = [value for value in axis.values if isinstance(value, Mapping)]
    yield from (f"{axis.path}.{key}" for key in dict.fromkeys(key for table in tables for key in table))
    if not tables:
        yield axis.path


def _check_presets(axis: Axis, base: Config) -> None:
    """Presets come with their own landmarks only where they are started from."""
    for name in map(str, axis.values):
        wanted, given = preset(name).landmarks.detector, base.landmarks.detector
        if wanted not in ("auto", given):
            raise ConfigError(
                f"The preset {name!r} takes the landmarks of {wanted!r}, and landmarks are found once per clip, here "
                f"by {given!r}; start from it with --preset {name}."
            )
