# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The parameter group ``truth``: the true values, and the errors that no estimator models.

The true values are declared here. One that may be left out (``| None``) stands in place of the
nominal value of the same name.

The errors are declared by their sources, each in its own file of ``simulation/errors``, and each
is off by default; `default_truth` joins them to these groups. This is the one place where the
configuration reaches up, and it does so by name: when the parameters are first used, not when this
module is imported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from functools import cache
from importlib import import_module
import math
import pkgutil
from types import ModuleType
from typing import Annotated, Any, TypeVar

from starcal_ros.config.instrument import MountingConfig
from starcal_ros.config.parameter import ConfigError, Spec

Floats = tuple[float, ...]
Group = TypeVar('Group')

_ERRORS = 'starcal_ros.simulation.errors'


@dataclass(frozen=True)
class TrueCameraConfig:
    """The camera that the simulators use; what is left out is as the nominal camera."""

    focal_length_mm: Annotated[float | None, Spec('Focal length', 'mm', 0.1, 1e5)] = None
    principal_point_px: Annotated[Floats | None, Spec(
        'Principal point u0, v0', 'px', -1e4, 1e4, 2)] = None
    distortion: Annotated[Floats | None, Spec(
        'Distortion k1, k2, p1, p2', 'mm^-2, mm^-4, mm^-1, mm^-1', -1.0, 1.0, 4)] = None


@dataclass(frozen=True)
class TrueMountingConfig(MountingConfig):
    """True rotation from the gyro axes to the star tracker; left out, it is the nominal one."""


@dataclass(frozen=True)
class TrueGyroConfig:
    """The gyro that the simulators use."""

    bias_deg_h: Annotated[Floats | None, Spec(
        'Bias at the start of the run', 'deg/h', -1e6, 1e6, 3)] = None
    arw_deg_sqrt_h: Annotated[float | None, Spec(
        'Angular random walk', 'deg/sqrt(h)', 0.0, 100.0)] = None


@dataclass(frozen=True)
class TrueStarTrackerConfig:
    """The star tracker that the simulators use."""

    centroid_sigma_px: Annotated[float | None, Spec(
        'Standard deviation of a centroid, each axis; the messages state the nominal one',
        'px', 0.0, 100.0)] = None
    time_offset_s: Annotated[float | None, Spec(
        "Stamp of a frame minus the middle of its exposure in the gyro's time: a positive stamp "
        'is late', 's', -10.0, 10.0)] = None


@dataclass(frozen=True)
class TrueObserverConfig:
    """Who looks at the sky in truth; what is left out is as the nominal observer."""

    velocity: Annotated[str | None, Spec(
        'Whose velocity aberrates the stars', choices=('barycentre', 'geocentre', 'orbit'))
    ] = None
    altitude_km: Annotated[float | None, Spec(
        'Circular orbit: altitude', 'km', 100.0, 1e6)] = None
    inclination_deg: Annotated[float | None, Spec(
        'Circular orbit: inclination', 'deg', 0.0, 180.0)] = None
    raan_deg: Annotated[float | None, Spec(
        'Circular orbit: right ascension of the ascending node', 'deg', -360.0, 360.0)] = None
    argument_of_latitude_deg: Annotated[float | None, Spec(
        'Circular orbit: argument of latitude at the epoch', 'deg', -360.0, 360.0)] = None
    epoch_utc: Annotated[str | None, Spec('Circular orbit: epoch, ISO 8601')] = None
    site_deg: Annotated[Floats | None, Spec(
        'On the ground: latitude and longitude, north and east', 'deg', -360.0, 360.0, 2)] = None
    site_height_m: Annotated[float | None, Spec(
        'Height of the site', 'm', -500.0, 50000.0)] = None
    site_pressure_hpa: Annotated[float | None, Spec(
        'Pressure at the site; 0 is no air', 'hPa', 0.0, 1200.0)] = None
    site_temperature_c: Annotated[float | None, Spec(
        'Temperature at the site', 'deg C', -100.0, 60.0)] = None


@dataclass(frozen=True)
class TruthConfig:
    """What the simulators use in place of the nominal values, and which errors they add.

    Here without the errors, which `default_truth` adds.
    """

    camera: TrueCameraConfig = field(default_factory=TrueCameraConfig)
    mounting: TrueMountingConfig = field(default_factory=TrueMountingConfig)
    gyro: TrueGyroConfig = field(default_factory=TrueGyroConfig)
    star_tracker: TrueStarTrackerConfig = field(default_factory=TrueStarTrackerConfig)
    observer: TrueObserverConfig = field(default_factory=TrueObserverConfig)

    def of(self, config: type[Group]) -> Group:
        """Return the values of an error source, from the group that its `Config` is part of."""
        for item in fields(self):
            group = getattr(self, item.name)
            if isinstance(group, config):
                return group
        raise LookupError(f'{config.__module__} has no parameters in this scenario')


def sources() -> tuple[ModuleType, ...]:
    """Return the error sources: the modules of ``simulation/errors``, in their order."""
    return _sources(tuple(import_module(_ERRORS).__path__))


@cache
def _sources(folders: tuple[str, ...]) -> tuple[ModuleType, ...]:
    found = [import_module(f'{_ERRORS}.{module.name}')
             for module in pkgutil.iter_modules(folders)]
    return tuple(sorted(found, key=lambda source: (order(source), source.__name__)))


def order(source: ModuleType) -> float:
    """Return the place of an error source among all; without an ``ORDER`` it is the last."""
    return getattr(source, 'ORDER', math.inf)


def default_truth() -> TruthConfig:
    """Return the group ``truth`` with the parameters of all error sources, each of them off.

    Raises
    ------
    ConfigError
        Where two declare the same parameter.
    """
    return _default(sources())


@cache
def _default(found: tuple[ModuleType, ...]) -> TruthConfig:
    truth = TruthConfig()
    parts: dict[str, list[type]] = {}
    for source in found:
        own = getattr(truth, source.GROUP, None)
        parts.setdefault(source.GROUP, [] if own is None else [type(own)]).append(source.Config)
    joined = {name: _joined(name, group) for name, group in parts.items()}
    made: type[TruthConfig] = make_dataclass(
        TruthConfig.__name__, [(name, type(group), group) for name, group in joined.items()],
        bases=(TruthConfig,), frozen=True, namespace={'__doc__': TruthConfig.__doc__})
    return made()


def _joined(name: str, parts: Sequence[type[Any]]) -> Any:
    """Return the defaults of a group that has the parameters of all its parts."""
    declared_by: dict[str, str] = {}
    for part in parts:
        for item in fields(part):
            if item.name in declared_by:
                raise ConfigError(f'truth.{name}.{item.name}: declared by '
                                  f'{declared_by[item.name]} and by {part.__module__}')
            declared_by[item.name] = part.__module__
    # Of several bases dataclass takes the fields of the last first.
    return make_dataclass(parts[0].__name__, [], bases=tuple(reversed(parts)), frozen=True,
                          namespace={'__doc__': parts[0].__doc__})()
