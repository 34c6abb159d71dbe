# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One scenario: every parameter of the suite, typed, validated, declared here and nowhere else.

A scenario is a ROS 2 parameter file (``/**: ros__parameters:``). The command line reads it with
`parameter_file`; the nodes declare the same fields as ROS parameters (``nodes/parameters.py``).
Each field carries its unit, its range and its text. A parameter that is None may be left out and
then has the meaning that its text gives.

The group ``truth`` (`truth`) holds what the simulators use in place of the nominal values
and which errors they add to them; nothing that estimates reads it.
"""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from dataclasses import dataclass, field
import difflib
import hashlib
import json
import math
import typing
from typing import Annotated, Any

from starcal_ros.config.image import ImageConfig
from starcal_ros.config.intrinsics import IntrinsicsConfig
from starcal_ros.config.nodes import (CentroidExtractorConfig, PlayerConfig, RecorderConfig,
                                      StarIdentifierConfig)
from starcal_ros.config.parameter import ConfigError, Parameter, Spec, declared
from starcal_ros.config.truth import (MountingDriftConfig, TrueCameraConfig, TrueGyroConfig,
                                      TrueObserverConfig, TrueStarTrackerConfig)
from starcal_ros.core.utc import unix_ns

Floats = tuple[float, ...]
Strings = tuple[str, ...]
ROS_OWN = ('use_sim_time', 'start_type_description_service', 'qos_overrides.')
"""Parameters that ROS 2 gives to every node: a parameter file may hold them."""

_TINY = 1e-12
_LONGEST_TRAIL_DEG = 5.0        # across a field of view of some 15 deg


@dataclass(frozen=True)
class CameraConfig:
    """Nominal camera: what is believed before the calibration."""

    width: Annotated[int, Spec('Width of the detector', 'px', 16, 65536)] = 1024
    height: Annotated[int, Spec('Height of the detector', 'px', 16, 65536)] = 1024
    pixel_pitch_mm: Annotated[float, Spec('Pixel pitch', 'mm', 1e-5, 1.0)] = 0.00645
    focal_length_mm: Annotated[float, Spec('Focal length', 'mm', 0.1, 1e5)] = 25.5
    principal_point_px: Annotated[Floats, Spec(
        'Principal point from the centre of the detector: u0, v0', 'px', -1e4, 1e4, 2)
    ] = (0.0, 0.0)
    distortion: Annotated[Floats, Spec(
        'Distortion k1, k2, p1, p2', 'mm^-2, mm^-4, mm^-1, mm^-1', -1.0, 1.0, 4)
    ] = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class MountingConfig:
    """Nominal rotation from the gyro axes to the star tracker, given in one of two ways."""

    fixed_angles_deg: Annotated[Floats | None, Spec(
        'Fixed angles x, y, z of C_sg = Rz(z) Ry(y) Rx(x)', 'deg', -360.0, 360.0, 3)] = None
    quaternion_xyzw: Annotated[Floats | None, Spec(
        'Quaternion of C_sg (g to s), in place of the fixed angles', '', -1.0, 1.0, 4)] = None


@dataclass(frozen=True)
class GyroConfig:
    """Gyro triad."""

    rate_hz: Annotated[float, Spec('Sampling rate', 'Hz', 1.0, 1e4)] = 100.0
    bias_deg_h: Annotated[Floats, Spec('Bias', 'deg/h', -1e6, 1e6, 3)] = (0.0, 0.0, 0.0)
    arw_deg_sqrt_h: Annotated[float, Spec(
        'Angular random walk', 'deg/sqrt(h)', 0.0, 100.0)] = 0.001


@dataclass(frozen=True)
class StarTrackerConfig:
    """Star tracker."""

    rate_hz: Annotated[float, Spec('Frame rate', 'Hz', 0.01, 1000.0)] = 2.0
    exposure_s: Annotated[float, Spec('Exposure', 's', 0.0, 10.0)] = 0.18
    centroid_sigma_px: Annotated[float, Spec(
        'Standard deviation of a centroid, each axis; in a recording that states its own sigma '
        'for a star, that one counts', 'px', 0.0, 100.0)] = 0.05
    limiting_magnitude: Annotated[float, Spec(
        'Faintest star that is measured, Hp', 'mag', -2.0, 14.0)] = 6.0


@dataclass(frozen=True)
class MotionConfig:
    """Rotations about the gyro axes, one after the other and then from the start again."""

    axes: Annotated[Strings, Spec(
        'Axis of each rotation, gyro frame', choices=('x', 'y', 'z'))] = (
            'x', 'y', 'z', 'z', 'y', 'x')
    angles_deg: Annotated[Floats, Spec('Angle of each rotation', 'deg', -360.0, 360.0)] = (
        30.0, 30.0, 30.0, -30.0, -30.0, -30.0)
    rate_deg_s: Annotated[float, Spec('Slew rate', 'deg/s', 1e-3, 100.0)] = 0.5
    acceleration_deg_s2: Annotated[float, Spec(
        'Angular acceleration at both ends of a slew', 'deg/s^2', 1e-3, 1e4)] = 0.5
    dwell_s: Annotated[float, Spec('Rest before each rotation', 's', 0.0, 1e5)] = 30.0
    initial_quaternion_xyzw: Annotated[Floats, Spec(
        'Attitude at the start: quaternion of C_ig (gyro in icrf)', '', -1.0, 1.0, 4)] = (
            0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class ObserverConfig:
    """Where the camera is and how fast it moves: parallax and stellar aberration."""

    velocity: Annotated[str, Spec(
        'Whose velocity aberrates the stars', choices=('barycentre', 'geocentre', 'orbit'))
    ] = 'geocentre'
    altitude_km: Annotated[float, Spec('Circular orbit: altitude', 'km', 100.0, 1e6)] = 500.0
    inclination_deg: Annotated[float, Spec(
        'Circular orbit: inclination', 'deg', 0.0, 180.0)] = 97.4
    raan_deg: Annotated[float, Spec(
        'Circular orbit: right ascension of the ascending node', 'deg', -360.0, 360.0)] = 0.0
    argument_of_latitude_deg: Annotated[float, Spec(
        'Circular orbit: argument of latitude at the epoch', 'deg', -360.0, 360.0)] = 0.0
    epoch_utc: Annotated[str, Spec('Circular orbit: epoch, ISO 8601')] = '2026-07-01T00:00:00'


@dataclass(frozen=True)
class TruthConfig:
    """What the simulators use in place of the nominal values, and the errors they add."""

    camera: TrueCameraConfig = field(default_factory=TrueCameraConfig)
    mounting: MountingConfig = field(default_factory=MountingConfig)
    mounting_drift: MountingDriftConfig = field(default_factory=MountingDriftConfig)
    gyro: TrueGyroConfig = field(default_factory=TrueGyroConfig)
    star_tracker: TrueStarTrackerConfig = field(default_factory=TrueStarTrackerConfig)
    observer: TrueObserverConfig = field(default_factory=TrueObserverConfig)


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
    images: Annotated[bool, Spec(
        'The star tracker delivers images (star_tracker/image_raw, group image), and its '
        'centroids as truth/centroids')] = False


@dataclass(frozen=True)
class SigmaConfig:
    """One standard deviation for each kind of calibrated state."""

    gyro_bias_deg_h: Annotated[float, Spec('Gyro bias', 'deg/h', _TINY, 1e6)]
    fixed_angles_arcsec: Annotated[float, Spec('Fixed angles', 'arcsec', _TINY, 1e6)]
    principal_point_px: Annotated[float, Spec('Principal point', 'px', _TINY, 1e4)]
    focal_length_mm: Annotated[float, Spec('Focal length', 'mm', _TINY, 1e4)]
    k1: Annotated[float, Spec('Distortion k1', 'mm^-2', _TINY, 1.0)]
    k2: Annotated[float, Spec('Distortion k2', 'mm^-4', _TINY, 1.0)]
    p1: Annotated[float, Spec('Distortion p1', 'mm^-1', _TINY, 1.0)]
    p2: Annotated[float, Spec('Distortion p2', 'mm^-1', _TINY, 1.0)]


@dataclass(frozen=True)
class ProcessNoiseConfig:
    """How fast each kind of calibrated state walks at random; 0 is a state that stays."""

    gyro_bias_deg_h_sqrt_h: Annotated[float, Spec(
        'Random walk of the gyro bias', 'deg/h/sqrt(h)', 0.0, 1e6, changeable=True)] = 0.0
    fixed_angles_arcsec_sqrt_h: Annotated[float, Spec(
        'Random walk of the fixed angles', 'arcsec/sqrt(h)', 0.0, 1e6, changeable=True)] = 0.0
    principal_point_px_sqrt_h: Annotated[float, Spec(
        'Random walk of the principal point', 'px/sqrt(h)', 0.0, 1e4, changeable=True)] = 0.0
    focal_length_mm_sqrt_h: Annotated[float, Spec(
        'Random walk of the focal length', 'mm/sqrt(h)', 0.0, 1e4, changeable=True)] = 0.0
    k1_sqrt_h: Annotated[float, Spec(
        'Random walk of k1', 'mm^-2/sqrt(h)', 0.0, 1.0, changeable=True)] = 0.0
    k2_sqrt_h: Annotated[float, Spec(
        'Random walk of k2', 'mm^-4/sqrt(h)', 0.0, 1.0, changeable=True)] = 0.0
    p1_sqrt_h: Annotated[float, Spec(
        'Random walk of p1', 'mm^-1/sqrt(h)', 0.0, 1.0, changeable=True)] = 0.0
    p2_sqrt_h: Annotated[float, Spec(
        'Random walk of p2', 'mm^-1/sqrt(h)', 0.0, 1.0, changeable=True)] = 0.0


@dataclass(frozen=True)
class AugmentConfig:
    """States appended to the 16; what is left out is taken as zero and not estimated."""

    gyro_matrix_sigma_ppm: Annotated[float | None, Spec(
        'Initial sigma of each element of M, the scale factors (diagonal) and misalignments of '
        'the gyros: they read (I + M) omega + bias', 'ppm', _TINY, 1e4)] = None
    time_offset_sigma_s: Annotated[float | None, Spec(
        'Initial sigma of tau, the time offset of the star tracker: a frame stamped t shows the '
        'sky of t + tau', 's', _TINY, 1.0)] = None


def _initial_sigma() -> SigmaConfig:
    return SigmaConfig(gyro_bias_deg_h=0.1, fixed_angles_arcsec=600.0, principal_point_px=20.0,
                       focal_length_mm=0.2, k1=1e-3, k2=1e-5, p1=1e-4, p2=1e-4)


def _tolerance() -> SigmaConfig:
    return SigmaConfig(gyro_bias_deg_h=2e-3, fixed_angles_arcsec=5.0, principal_point_px=0.1,
                       focal_length_mm=2e-4, k1=2e-6, k2=2e-7, p1=1e-6, p2=1e-6)


@dataclass(frozen=True)
class EstimatorConfig:
    """The 16-state filter."""

    initial_sigma: SigmaConfig = field(default_factory=_initial_sigma)
    tolerance: SigmaConfig = field(default_factory=_tolerance)
    process_noise: ProcessNoiseConfig = field(default_factory=ProcessNoiseConfig)
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    feedback: Annotated[bool, Spec(
        'Correct the nominal values after each frame; false is the open-loop filter of the '
        'paper')] = True
    gate_probability: Annotated[float, Spec(
        'Probability with which a good star passes the chi-square gate', '', 0.5, 1.0,
        changeable=True)] = 0.9999
    reacquire_after_frames: Annotated[int, Spec(
        'Frames in a row, most of their stars rejected, before the attitude is found afresh',
        '', 1, 1000, changeable=True)] = 5
    gap_acceleration_deg_s2: Annotated[float, Spec(
        'Angular acceleration that may hide in a silence of the gyro', 'deg/s^2', 0.0, 1e4,
        changeable=True)] = 1.0
    wait_for_subscribers: Annotated[int, Spec(
        'Subscribers that each result topic must have before the sensors are listened to', '', 0,
        100)] = 0
    calibration_directory: Annotated[str, Spec(
        'Where the service save_calibration puts calibrations, in a numbered folder each; in a '
        'namespace, in its folder there')] = 'calibrations'
    load_calibration: Annotated[bool, Spec(
        'Start from the newest calibration there, values and covariance, if there is one')] = False


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
    truth: TruthConfig = field(default_factory=TruthConfig)
    simulation: SimulationConfig = field(default_factory=SimulationConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    intrinsics: IntrinsicsConfig = field(default_factory=IntrinsicsConfig)
    centroid_extractor: CentroidExtractorConfig = field(default_factory=CentroidExtractorConfig)
    star_identifier: StarIdentifierConfig = field(default_factory=StarIdentifierConfig)
    recorder: RecorderConfig = field(default_factory=RecorderConfig)
    player: PlayerConfig = field(default_factory=PlayerConfig)

    def __post_init__(self) -> None:
        for key, parameter in parameters().items():
            parameter.check(key, _get(self, key))
        _check_together(self)

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


_PARAMETERS: dict[str, Parameter] = {}


def parameters() -> Mapping[str, Parameter]:
    """Return every parameter of the suite by its dotted name, in the order of declaration."""
    if not _PARAMETERS:
        _PARAMETERS.update(declared(Scenario))
    return _PARAMETERS


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
        For an unknown name, a wrong type or an impossible value.
    """
    known = parameters()
    tree: dict[str, Any] = {}
    for key, value in values.items():
        if key.startswith(ROS_OWN):
            continue
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            hint = f'; did you mean {near[0]}?' if near else ''
            raise ConfigError(f'{key}: unknown parameter{hint}')
        *path, name = key.split('.')
        branch = tree
        for part in path:
            branch = branch.setdefault(part, {})
        branch[name] = known[key].convert(key, value)
    return typing.cast(Scenario, _replace(Scenario(), tree))


def _replace(default: Any, tree: Mapping[str, Any]) -> Any:
    return dataclasses.replace(default, **{
        name: _replace(getattr(default, name), value) if isinstance(value, dict) else value
        for name, value in tree.items()})


def _check_together(scenario: Scenario) -> None:
    for name, mounting in (('mounting', scenario.mounting),
                           ('truth.mounting', scenario.truth.mounting)):
        if mounting.fixed_angles_deg is not None and mounting.quaternion_xyzw is not None:
            raise ConfigError(f'{name}: fixed_angles_deg and quaternion_xyzw are both given, '
                              'one is allowed')
    for key in ('mounting.quaternion_xyzw', 'truth.mounting.quaternion_xyzw',
                'motion.initial_quaternion_xyzw'):
        value = _get(scenario, key)
        if value is not None and abs(math.hypot(*value) - 1.0) > 1e-6:
            raise ConfigError(f'{key}: got norm {math.hypot(*value):.9g}, a quaternion has norm 1')
    motion = scenario.motion
    if not motion.axes or len(motion.axes) != len(motion.angles_deg):
        raise ConfigError(f'motion.angles_deg: got {len(motion.angles_deg)} angles for '
                          f'{len(motion.axes)} axes, needs as many, and at least one')
    if motion.dwell_s == 0.0 and not any(motion.angles_deg):
        raise ConfigError('motion.dwell_s: got 0.0 and no angle but 0, needs a dwell or an angle')
    trail_deg = motion.rate_deg_s * scenario.star_tracker.exposure_s
    for key in ('truth.star_tracker.smear', 'simulation.images'):
        if _get(scenario, key) and trail_deg > _LONGEST_TRAIL_DEG:
            raise ConfigError(f'{key}: got trails of {trail_deg:g} deg (slew rate times '
                              f'exposure), allowed is 0 to {_LONGEST_TRAIL_DEG:g} deg')
    for key in ('observer.epoch_utc', 'truth.observer.epoch_utc', 'simulation.start_utc'):
        if (text := _get(scenario, key)) is not None:
            stamp_ns(key, text)


def stamp_ns(key: str, text: str) -> int:
    """Return the ISO 8601 time of a parameter as ns since the Unix epoch."""
    try:
        return unix_ns(text)
    except ValueError:
        raise ConfigError(f'{key}: got {text!r}, needs an ISO 8601 time such as '
                          '2026-07-02T12:00:00') from None
