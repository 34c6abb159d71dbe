# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults, put into the messages of a recording or into what is stated of it.

Any recording will do, a simulated one or one that others made. A fault of the messages takes them
and a generator of random numbers, and gives other ones; a fault of the statement takes the right
scenario, and gives the parameters that are stated wrongly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from starcal_ros.config.models import mounting_matrix
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import DEG_PER_HOUR, DEG_PER_SQRT_HOUR, NS
from starcal_ros.measurements.samples import Frames, GyroSamples

Messages = tuple[GyroSamples, Frames]
Spoil = Callable[[GyroSamples, Frames, np.random.Generator], Messages]
Statement = Callable[[Scenario], Mapping[str, Any]]


# What is done to the messages


def nothing(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    """Leave the messages as they are."""
    return gyro, frames


def rates(change: Callable[[Array], Array]) -> Spoil:
    """Return what changes all readings."""
    return lambda gyro, frames, rng: (GyroSamples(gyro.stamp_ns, change(gyro.rate)), frames)


def gyro_stamps(change: Callable[[Array], Array]) -> Spoil:
    """Return what moves the stamps of the gyro: by seconds, from the seconds since the first."""
    def spoil(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
        since = (gyro.stamp_ns - gyro.stamp_ns[0]) * NS
        moved = np.rint(1e9 * change(since)).astype(np.int64)
        return GyroSamples(gyro.stamp_ns + moved, gyro.rate), frames
    return spoil


def frame_stamps(change: Callable[[Array], Array]) -> Spoil:
    """Return what moves the stamps of the frames, as `gyro_stamps`."""
    def spoil(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
        since = (frames.stamp_ns - frames.stamp_ns[0]) * NS
        moved = np.rint(1e9 * change(since)).astype(np.int64)
        return gyro, replace(frames, stamp_ns=frames.stamp_ns + moved)
    return spoil


def centroids(change: Callable[[Array], Array]) -> Spoil:
    """Return what changes all centroids."""
    return lambda gyro, frames, rng: (gyro, replace(frames, uv_raster=change(frames.uv_raster)))


def numbers(change: Callable[[Ints, np.random.Generator], Ints]) -> Spoil:
    """Return what changes the catalogue numbers."""
    return lambda gyro, frames, rng: (gyro, replace(frames, catalog_id=change(
        frames.catalog_id, rng)))


def _period_s(gyro: GyroSamples) -> float:
    return float(np.median(np.diff(gyro.stamp_ns))) * NS


def noisy(arw_deg_sqrt_h: float) -> Spoil:
    """Return what adds an angular random walk to that of the gyros."""
    def spoil(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
        more = np.sqrt(arw_deg_sqrt_h**2 - 1e-6)        # beside 0.001
        size = more * DEG_PER_SQRT_HOUR / np.sqrt(_period_s(gyro))
        return GyroSamples(gyro.stamp_ns, gyro.rate
                           + size * rng.standard_normal(gyro.rate.shape)), frames
    return spoil


def walking(deg_h_sqrt_h: float) -> Spoil:
    """Return what lets the bias walk, to end where it is."""
    def spoil(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
        step = deg_h_sqrt_h * DEG_PER_HOUR * np.sqrt(_period_s(gyro) / 3600.0)
        walk = np.cumsum(step * rng.standard_normal(gyro.rate.shape), axis=0)
        return GyroSamples(gyro.stamp_ns, gyro.rate + walk - walk[-1]), frames
    return spoil


def scattered(more_px: float) -> Spoil:
    """Return what adds noise to the centroids."""
    return lambda gyro, frames, rng: (gyro, replace(
        frames, uv_raster=frames.uv_raster + more_px * rng.standard_normal(
            frames.uv_raster.shape)))


def stated_sigma(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    """Have the messages state a sigma of 0.1 px."""
    return gyro, replace(frames, sigma=np.full_like(frames.sigma, 0.1))


def repeated(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    """Publish every second reading twice, in place of the next one."""
    return GyroSamples(gyro.stamp_ns, np.repeat(gyro.rate[::2], 2, axis=0)[:len(gyro)]), frames


def frozen(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    """Let the readings stand still from 100 s to 110 s."""
    since = (gyro.stamp_ns - gyro.stamp_ns[0]) * NS
    stuck = (since > 100.0) & (since < 110.0)
    rate = np.where(stuck[:, None], gyro.rate[np.argmax(stuck)], gyro.rate)
    return GyroSamples(gyro.stamp_ns, rate), frames


def bursts(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    """Stamp ten readings at once, 20 us apart, when the last of them is there."""
    last = np.minimum(np.arange(len(gyro)) // 10 * 10 + 9, len(gyro) - 1)
    return GyroSamples(gyro.stamp_ns[last] + np.arange(len(gyro)) % 10 * 20_000, gyro.rate), frames


def arrived(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    """Stamp the readings when they arrive, late by 4 ms on average."""
    late = np.rint(rng.exponential(4e6, len(gyro))).astype(np.int64)
    return GyroSamples(np.maximum.accumulate(gyro.stamp_ns + late)
                       + np.arange(len(gyro)), gyro.rate), frames


def jittered(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    """Let the stamps of the frames scatter by 3 ms."""
    return gyro, replace(frames, stamp_ns=frames.stamp_ns + np.rint(
        3e6 * rng.standard_normal(len(frames))).astype(np.int64))


def mixed(catalog_id: Ints, rng: np.random.Generator) -> Ints:
    """Give a tenth of the stars the numbers of others."""
    wrong = rng.random(len(catalog_id)) < 0.1
    return np.where(wrong, rng.permutation(catalog_id), catalog_id)


def both_stamps(change_ns: Callable[[int], int]) -> Spoil:
    """Return what moves the stamps of both by so much, given the first of the gyro [ns]."""
    def spoil(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
        by = change_ns(int(gyro.stamp_ns[0]))
        return (GyroSamples(gyro.stamp_ns + by, gyro.rate),
                replace(frames, stamp_ns=frames.stamp_ns + by))
    return spoil


def from_boot(gyro: GyroSamples, frames: Frames, rng: np.random.Generator) -> Messages:
    """Stamp the readings since boot, ten seconds before the first."""
    return GyroSamples(gyro.stamp_ns - gyro.stamp_ns[0] + 10**10, gyro.rate), frames


# What is stated


def as_stated(scenario: Scenario) -> Mapping[str, Any]:
    """State what is right."""
    return {}


def mounted(change: Callable[[Array], Array]) -> Statement:
    """Return what states another mounting."""
    return lambda scenario: {'mounting.quaternion_xyzw': tuple(rotation.to_quaternion(
        change(mounting_matrix(scenario.mounting))).tolist())}


def w_first(scenario: Scenario) -> Mapping[str, Any]:
    """State the quaternion of the mounting in the order w, x, y, z."""
    x, y, z, w = scenario.mounting.quaternion_xyzw or (0.0, 0.0, 0.0, 1.0)
    return {'mounting.quaternion_xyzw': (w, x, y, z)}


def saying(**values: Any) -> Statement:
    """Return what states some parameters, their dots written as double underscores."""
    return lambda scenario: {key.replace('__', '.'): value for key, value in values.items()}
