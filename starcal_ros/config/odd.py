# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Values that are allowed and yet odd: most often a unit, or two values that do not go together.

Each rule knows what instruments of the kind have. A warning says what follows from the values, and
what they would have to be like; none is an error.
"""

from __future__ import annotations

from collections.abc import Iterator
import dataclasses
import math
from typing import NamedTuple

from starcal_ros.config.scenario import Scenario
from starcal_ros.sky import catalog

_FIELD_DEG = (0.5, 100.0)       # of view across the detector, of star cameras
_PITCH_MM = (0.8e-3, 0.05)      # of the pixels of image sensors
_SHIFT = 0.25                   # part of the detector by which a lens is off its centre
_DISTORTION = 0.3               # of the lens at the corner; a fisheye has more
_ARW_DEG_SQRT_H = (1e-5, 5.0)   # from the best laser gyros to the cheapest chips
_BIAS_DEG_H = 3.6e4             # 10 deg/s
_BIAS_OVER_ARW = 5.0            # 1/sqrt(h); of the gyros of T18 it is 100
_CENTROID_PX = (0.003, 2.0)
_STARS = (4.0, 500.0)           # in a frame
_TRAIL_PX = 50.0


class Odd(NamedTuple):
    """One odd value: the parameter, and what is odd."""

    parameter: str
    text: str


def odd(scenario: Scenario) -> list[Odd]:
    """Return what is odd of a scenario."""
    return [*_camera(scenario), *_gyro(scenario), *_star_tracker(scenario), *_sigmas(scenario)]


def field_of_view_deg(scenario: Scenario) -> tuple[float, float]:
    """Return the field of view of the nominal camera across width and height [deg]."""
    camera = scenario.camera
    across, down = (2.0 * math.degrees(math.atan(
        0.5 * pixels * camera.pixel_pitch_mm / camera.focal_length_mm))
        for pixels in (camera.width, camera.height))
    return across, down


def stars_in_field(scenario: Scenario) -> float:
    """Return how many stars of the shipped catalogue a frame shows, the mean over the sky."""
    across, down = (math.radians(angle) for angle in field_of_view_deg(scenario))
    part = math.asin(math.sin(0.5 * across) * math.sin(0.5 * down)) / math.pi       # of the sky
    return part * len(catalog.load(scenario.star_tracker.limiting_magnitude).hip)


def _camera(scenario: Scenario) -> Iterator[Odd]:
    camera = scenario.camera
    across, down = field_of_view_deg(scenario)
    if not _FIELD_DEG[0] <= max(across, down) <= _FIELD_DEG[1]:
        yield Odd('camera.focal_length_mm',
                  f'{camera.focal_length_mm:g} mm before pixels of {camera.pixel_pitch_mm:g} mm '
                  f'give a field of view of {across:.3g} by {down:.3g} deg; star cameras have '
                  f'{_FIELD_DEG[0]:g} to {_FIELD_DEG[1]:g}')
    if not _PITCH_MM[0] <= camera.pixel_pitch_mm <= _PITCH_MM[1]:
        yield Odd('camera.pixel_pitch_mm', f'{camera.pixel_pitch_mm:g} mm; image sensors have '
                  f'{_PITCH_MM[0]:g} to {_PITCH_MM[1]:g}')
    u0, v0 = camera.principal_point_px
    if abs(u0) > _SHIFT * camera.width or abs(v0) > _SHIFT * camera.height:
        yield Odd('camera.principal_point_px', f'{u0:g}, {v0:g} px from the centre of the '
                  f'detector, which has {camera.width} by {camera.height}: it counts from the '
                  'centre, not from the corner')
    corner_mm = 0.5 * math.hypot(camera.width, camera.height) * camera.pixel_pitch_mm
    k1, k2, p1, p2 = camera.distortion
    part = max(abs(k1 * corner_mm**2 + k2 * corner_mm**4),
               3.0 * math.hypot(p1, p2) * corner_mm)
    if part > _DISTORTION:
        yield Odd('camera.distortion', f'moves the corner, {corner_mm:.3g} mm from the centre, by '
                  f'{100 * part:.3g} % of that; k1, k2, p1, p2 are in mm^-2, mm^-4, mm^-1, mm^-1, '
                  'not those of OpenCV')


def _gyro(scenario: Scenario) -> Iterator[Odd]:
    gyro, sigma = scenario.gyro, scenario.estimator.initial_sigma
    arw = gyro.arw_deg_sqrt_h
    if not _ARW_DEG_SQRT_H[0] <= arw <= _ARW_DEG_SQRT_H[1]:
        yield Odd('gyro.arw_deg_sqrt_h', f'{arw:g} deg/sqrt(h); gyros have '
                  f'{_ARW_DEG_SQRT_H[0]:g} to {_ARW_DEG_SQRT_H[1]:g} (1 deg/s/sqrt(Hz) is '
                  '60 deg/sqrt(h))')
    if (bias := max(map(abs, gyro.bias_deg_h))) > _BIAS_DEG_H:
        yield Odd('gyro.bias_deg_h', f'{bias:g} deg/h are {bias / 3600:.3g} deg/s')
    if sigma.gyro_bias_deg_h < _BIAS_OVER_ARW * arw:
        yield Odd('estimator.initial_sigma.gyro_bias_deg_h',
                  f'{sigma.gyro_bias_deg_h:g} deg/h for gyros with an angular random walk of '
                  f'{arw:g} deg/sqrt(h): such switch on with a bias that is less well known')
    walk = scenario.estimator.process_noise.gyro_bias_deg_h_sqrt_h
    if walk > 10.0 * sigma.gyro_bias_deg_h:
        yield Odd('estimator.process_noise.gyro_bias_deg_h_sqrt_h',
                  f'{walk:g} deg/h/sqrt(h): in minutes the bias would leave its initial sigma of '
                  f'{sigma.gyro_bias_deg_h:g} deg/h')


def _star_tracker(scenario: Scenario) -> Iterator[Odd]:
    tracker, gyro = scenario.star_tracker, scenario.gyro
    if tracker.exposure_s > 1.0 / tracker.rate_hz:
        yield Odd('star_tracker.exposure_s', f'{tracker.exposure_s:g} s, longer than the '
                  f'{1.0 / tracker.rate_hz:g} s between frames')
    if gyro.rate_hz < 2.0 * tracker.rate_hz:
        yield Odd('gyro.rate_hz', f'{gyro.rate_hz:g} Hz, of readings that carry the attitude '
                  f'between frames of {tracker.rate_hz:g} Hz')
    if not _CENTROID_PX[0] <= tracker.centroid_sigma_px <= _CENTROID_PX[1]:
        yield Odd('star_tracker.centroid_sigma_px', f'{tracker.centroid_sigma_px:g} px; '
                  f'centroids have {_CENTROID_PX[0]:g} to {_CENTROID_PX[1]:g}')
    across, down = field_of_view_deg(scenario)
    if _FIELD_DEG[0] <= max(across, down) <= _FIELD_DEG[1] and (
            tracker.limiting_magnitude <= catalog.SHIPPED_LIMIT):
        stars = stars_in_field(scenario)
        if not _STARS[0] <= stars <= _STARS[1]:
            yield Odd('star_tracker.limiting_magnitude', f'Hp {tracker.limiting_magnitude:g} in '
                      f'{across:.3g} by {down:.3g} deg shows about {stars:.2g} stars')
    motion = scenario.motion
    trail = motion.rate_deg_s * tracker.exposure_s * math.pi / 180.0 * (
        scenario.camera.focal_length_mm / scenario.camera.pixel_pitch_mm)
    if tracker.smear and trail > _TRAIL_PX:
        yield Odd('motion.rate_deg_s', f'{motion.rate_deg_s:g} deg/s draw stars out to trails of '
                  f'{trail:.3g} px in {tracker.exposure_s:g} s')


def _sigmas(scenario: Scenario) -> Iterator[Odd]:
    initial, tolerance = scenario.estimator.initial_sigma, scenario.estimator.tolerance
    for item in dataclasses.fields(initial):
        begins, ends = getattr(initial, item.name), getattr(tolerance, item.name)
        if ends >= begins:
            yield Odd(f'estimator.tolerance.{item.name}', f'{ends:g} is not less than '
                      f'estimator.initial_sigma.{item.name}, {begins:g}: the state counts as '
                      'known before there are any data')
    camera = scenario.camera
    corner_mm = 0.5 * math.hypot(camera.width, camera.height) * camera.pixel_pitch_mm
    for name, power in (('k1', 2), ('k2', 4), ('p1', 1), ('p2', 1)):
        part = getattr(initial, name) * corner_mm**power
        if part > _DISTORTION:
            yield Odd(f'estimator.initial_sigma.{name}', f'{getattr(initial, name):g} moves the '
                      f'corner, {corner_mm:.3g} mm from the centre, by {100 * part:.3g} % of that')
    if initial.focal_length_mm > _DISTORTION * camera.focal_length_mm:
        yield Odd('estimator.initial_sigma.focal_length_mm', f'{initial.focal_length_mm:g} mm, of '
                  f'a focal length of {camera.focal_length_mm:g} mm')
