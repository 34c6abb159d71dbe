# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One scenario: every parameter of the suite, typed and validated, declared once.

A scenario is a ROS 2 parameter file (``/**: ros__parameters:``). The command line reads it with
`parameter_file`; the nodes declare the same fields as ROS parameters (`nodes.base.parameters`).
Each field carries its unit, its range and its text. A parameter that is None may be left out and
then has the meaning that its text gives.

The group ``truth`` holds what the simulators use in place of the nominal values and which errors
they add to them; nothing that estimates reads it. The errors are found by name (`config.truth`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
import dataclasses
from dataclasses import dataclass, field
import difflib
from functools import cache
import hashlib
import json
import math
from types import ModuleType
import typing
from typing import Annotated, Any

from starcal_ros.config.estimator import EstimatorConfig
from starcal_ros.config.image import ImageConfig
from starcal_ros.config.instrument import (CameraConfig, GyroConfig, MotionConfig, MountingConfig,
                                           ObserverConfig, StarTrackerConfig)
from starcal_ros.config.intrinsics import IntrinsicsConfig
from starcal_ros.config.nodes import (CentroidExtractorConfig, PlayerConfig, RecorderConfig,
                                      ServeConfig, StarIdentifierConfig)
from starcal_ros.config.parameter import ConfigError, Parameter, Spec, declared
from starcal_ros.config.truth import TruthConfig, default_truth, sources
from starcal_ros.core.utc import unix_ns

Floats = tuple[float, ...]
Strings = tuple[str, ...]
ROS_OWN = ('use_sim_time', 'start_type_description_service', 'qos_overrides.')
"""Parameters that ROS 2 gives to every node: a parameter file may hold them."""

_LONGEST_TRAIL_DEG = 5.0        # across a field of view of some 15 deg


@dataclass(frozen=True)
class SimulationConfig:
    """When the simulated run begins, how long and how fast it is, and its randomness."""

    start_utc: Annotated[str, Spec('Stamp at which the run begins, ISO 8601')] = (
        '2026-07-02T12:00:00')
    duration_s: Annotated[float, Spec('Length of the run', 's', 0.0, 1e7)] = 7200.0
    seed: Annotated[int, Spec('Seed of all randomness', '', 0, 2**53)] = 1
    real_time_factor: Annotated[float, Spec(
        'Simulated seconds a second; 0 is as fast as the subscribers take it', '', 0.0, 1e6)
    ] = 1.0
    wait_for_subscribers: Annotated[int, Spec(
        'Subscribers that each sensor topic must have before the run begins', '', 0, 100)] = 0
    wait_for_nodes: Annotated[Strings, Spec(
        'Nodes, by name, that must subscribe to each sensor topic before the run begins; no other '
        'subscriber stands in for them')] = ()
    wait_for_simulators: Annotated[int, Spec(
        'Other simulators that must be there before the run begins', '', 0, 100)] = 0
    images: Annotated[bool, Spec(
        'The star tracker delivers images (star_tracker/image_raw, group image), and its '
        'centroids as truth/centroids')] = False


@dataclass(frozen=True)
class Scenario:
    """All of one parameter file."""

    autostart: Annotated[bool, Spec(
        'The managed nodes (estimator, recorder, ...) configure and activate themselves')] = True
    camera: CameraConfig = field(default_factory=CameraConfig)
    mounting: MountingConfig = field(default_factory=MountingConfig)
    gyro: GyroConfig = field(default_factory=GyroConfig)
    star_tracker: StarTrackerConfig = field(default_factory=StarTrackerConfig)
    image: ImageConfig = field(default_factory=ImageConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    observer: ObserverConfig = field(default_factory=ObserverConfig)
    truth: TruthConfig = field(default_factory=default_truth)
    simulation: SimulationConfig = field(default_factory=SimulationConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    intrinsics: IntrinsicsConfig = field(default_factory=IntrinsicsConfig)
    centroid_extractor: CentroidExtractorConfig = field(default_factory=CentroidExtractorConfig)
    star_identifier: StarIdentifierConfig = field(default_factory=StarIdentifierConfig)
    recorder: RecorderConfig = field(default_factory=RecorderConfig)
    player: PlayerConfig = field(default_factory=PlayerConfig)
    serve: ServeConfig = field(default_factory=ServeConfig)

    def __post_init__(self) -> None:
        errors = [text for key, parameter in parameters().items()
                  for text in _errors(parameter.check, key, _get(self, key))]
        if errors or (errors := list(_check_together(self))):
            raise ConfigError(*errors)

    def __reduce__(self) -> tuple[Any, ...]:
        # By value: the classes of the group truth are made where the error sources are found.
        return from_flat, (self.flat(),)

    def flat(self) -> dict[str, Any]:
        """Return every parameter that has a value, by its dotted name."""
        values = ((key, _get(self, key)) for key in parameters())
        return {key: value for key, value in values if value is not None}

    def replace(self, values: Mapping[str, Any]) -> Scenario:
        """Return a copy with some parameters, given by dotted name, replaced."""
        return from_flat({**self.flat(), **values})

    @property
    def sha256(self) -> str:
        """Hash of all values: two scenarios are the same when this is."""
        text = json.dumps(self.flat(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def parameters() -> Mapping[str, Parameter]:
    """Return every parameter of the suite by its dotted name, in the order of declaration."""
    return _parameters(sources())


@cache
def _parameters(found: tuple[ModuleType, ...]) -> Mapping[str, Parameter]:
    return dict(declared(Scenario))


def _get(scenario: Scenario, key: str) -> Any:
    value: Any = scenario
    for name in key.split('.'):
        value = getattr(value, name)
    return value


def from_flat(values: Mapping[str, Any]) -> Scenario:
    """Build a scenario from dotted names; what is absent takes its default.

    The parameters of `ROS_OWN` are passed over.

    Raises
    ------
    ConfigError
        For each unknown name, wrong type or impossible value.
    """
    known = parameters()
    tree: dict[str, Any] = {}
    errors: list[str] = []
    wrong: set[str] = set()             # groups with an error, of which more would follow
    for key, value in values.items():
        if key.startswith(ROS_OWN):
            continue
        if key not in known:
            errors.append(unknown(key))
            continue
        *path, name = key.split('.')
        try:
            converted = known[key].convert(key, value)
            known[key].check(key, converted)
        except ConfigError as error:
            errors += error.errors
            wrong.add('.'.join(path))
            continue
        branch = tree
        for part in path:
            branch = branch.setdefault(part, {})
        branch[name] = converted
    try:
        scenario = typing.cast(Scenario, _replace(Scenario(), tree))
    except ConfigError as error:
        errors += [text for text in error.errors
                   if not {(key := text.partition(':')[0]), key.rpartition('.')[0]} & wrong]
    if errors:
        raise ConfigError(*errors)
    return scenario


def _errors(check: Callable[..., object], *arguments: Any) -> tuple[str, ...]:
    """Return what a check says."""
    try:
        check(*arguments)
    except ConfigError as error:
        return error.errors
    return ()


def unknown(key: str, groups: Iterable[str] = ()) -> str:
    """Return what to say of a name that no parameter has: which has nearly that name.

    Where a group would do, too, `groups` are theirs.
    """
    last = key.rpartition('.')[2]
    near = ([known for known in parameters() if known.endswith(f'.{key}')]
            or [known for known in parameters() if key and f'.{key}' in f'.{known}']
            or difflib.get_close_matches(key, [*parameters(), *ROS_OWN, *groups], n=1)
            or [known for known in parameters() if known.endswith(f'.{last}')])
    what = 'parameter or group' if groups else 'parameter'
    asked = f'; did you mean {" or ".join(near[:3])}?' if near else ''
    return f'{key}: unknown {what}{asked}'


def _replace(default: Any, tree: Mapping[str, Any]) -> Any:
    return dataclasses.replace(default, **{
        name: _replace(getattr(default, name), value) if isinstance(value, dict) else value
        for name, value in tree.items()})


def _check_together(scenario: Scenario) -> Iterator[str]:
    """Yield the errors of values that do not go together."""
    for name, mounting in (('mounting', scenario.mounting),
                           ('truth.mounting', scenario.truth.mounting)):
        if mounting.fixed_angles_deg is not None and mounting.quaternion_xyzw is not None:
            yield (f'{name}: fixed_angles_deg and quaternion_xyzw are both given, '
                   'one is allowed')
    for key in ('mounting.quaternion_xyzw', 'truth.mounting.quaternion_xyzw',
                'motion.initial_quaternion_xyzw'):
        value = _get(scenario, key)
        if value is not None and abs(math.hypot(*value) - 1.0) > 1e-6:
            yield f'{key}: got norm {math.hypot(*value):.9g}, a quaternion has norm 1'
    for name, at, velocity in (
            ('observer', scenario.observer.site_deg, scenario.observer.velocity),
            ('truth.observer', scenario.truth.observer.site_deg or scenario.observer.site_deg,
             scenario.truth.observer.velocity or scenario.observer.velocity)):
        if at is not None and abs(at[0]) > 90.0:
            yield f'{name}.site_deg: got a latitude of {at[0]:g}, needs -90 to 90'
        if at is not None and velocity == 'orbit':
            yield f'{name}.site_deg: got a site on the ground and velocity orbit, one is allowed'
    motion = scenario.motion
    if not motion.axes or len(motion.axes) != len(motion.angles_deg):
        yield (f'motion.angles_deg: got {len(motion.angles_deg)} angles for '
               f'{len(motion.axes)} axes, needs as many, and at least one')
    if motion.dwell_s == 0.0 and not any(motion.angles_deg):
        yield 'motion.dwell_s: got 0.0 and no angle but 0, needs a dwell or an angle'
    for source in sources():
        if hasattr(source, 'check'):
            yield from _errors(source.check, scenario)
    if scenario.simulation.images:
        yield from _errors(check_trails, 'simulation.images', scenario)
    wrong = [text for key in ('observer.epoch_utc', 'truth.observer.epoch_utc',
                              'simulation.start_utc', 'estimator.earliest_utc',
                              'estimator.latest_utc')
             if (value := _get(scenario, key)) is not None
             for text in _errors(stamp_ns, key, value)]
    yield from wrong or _errors(_check_times, scenario.estimator)


def _check_times(estimator: EstimatorConfig) -> None:
    """Raise ConfigError where no stamp would be believed."""
    if stamp_ns('estimator.latest_utc', estimator.latest_utc) <= stamp_ns(
            'estimator.earliest_utc', estimator.earliest_utc):
        raise ConfigError(f'estimator.latest_utc: got {estimator.latest_utc}, needs to be later '
                          f'than estimator.earliest_utc, {estimator.earliest_utc}')


def check_trails(key: str, scenario: Scenario) -> None:
    """Raise ConfigError where stars trail too far for what the parameter `key` asks for."""
    trail_deg = scenario.motion.rate_deg_s * scenario.star_tracker.exposure_s
    if trail_deg > _LONGEST_TRAIL_DEG:
        raise ConfigError(f'{key}: got trails of {trail_deg:g} deg (slew rate times '
                          f'exposure), allowed is 0 to {_LONGEST_TRAIL_DEG:g} deg')


def stamp_ns(key: str, text: str) -> int:
    """Return the ISO 8601 time of a parameter as ns since the Unix epoch."""
    try:
        return unix_ns(text)
    except ValueError:
        raise ConfigError(f'{key}: got {text!r}, needs an ISO 8601 time such as '
                          '2026-07-02T12:00:00') from None
