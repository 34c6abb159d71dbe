# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Spots are followed by the same number from frame to frame, the right ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import poisson

from instruments import TAN2018
from starcal_ros.core import rotation
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.measurements.spot_tracker import PATIENCE, SpotTracker
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

SCENARIO = TAN2018.replace({'simulation.duration_s': 150.0, 'motion.dwell_s': 15.0})
"""0.5 deg/s and rest by turns, 2 Hz, a field of 15 deg, its focal length taken 0.1 mm wrong."""
SIZE = SCENARIO.camera.width
MISSING, FALSE = 0.1, 5
GATE_PART = np.pi * 3.0**2 / SIZE**2        # part of the detector that lies inside a gate


@pytest.fixture(scope='module')
def clean():
    return sensors.star_tracker(SCENARIO).next(10**6)


@pytest.fixture(scope='module')
def gyro():
    return sensors.gyro(SCENARIO).next(10**6)


def spoiled(frames, seed=1):
    """Return the frames with stars missing and false spots, the spots in random order."""
    rng = np.random.default_rng(seed)
    frame = frames.frame_index
    keep = rng.random(len(frame)) >= MISSING
    false = np.repeat(np.arange(len(frames)), FALSE)
    frame = np.concatenate((frame[keep], false))
    order = np.lexsort((rng.random(len(frame)), frame))
    uv = np.concatenate((frames.uv_raster[keep], rng.uniform(0.0, SIZE - 1.0, (len(false), 2))))
    hip = np.concatenate((frames.catalog_id[keep], np.zeros(len(false), np.int64)))
    first = np.concatenate(([0], np.cumsum(np.bincount(frame, minlength=len(frames)))))
    return Frames(frames.stamp_ns, first, uv[order], np.full(len(order), 0.05),
                  np.full(len(order), np.nan), hip[order])


def links(frames, key, counted):
    """Return pairs of rows with one key that follow each other within the patience."""
    frame = frames.frame_index
    rows = np.flatnonzero(counted)
    rows = rows[np.lexsort((frame[rows], key[rows]))]
    near = ((key[rows][1:] == key[rows][:-1])
            & (frame[rows][1:] - frame[rows][:-1] <= PATIENCE + 1))
    return rows[:-1][near], rows[1:][near]


def score(frames, track):
    """Return the numbers of wrong links, of all links, of right ones missed, of all right ones."""
    hip = frames.catalog_id
    a, b = links(frames, track, track >= 0)
    right = (hip[a] == hip[b]) & (hip[a] > 0)
    wanted = set(zip(*(part.tolist() for part in links(frames, hip, hip > 0))))
    found = set(zip(a[right].tolist(), b[right].tolist()))
    return int((~right).sum()), len(a), len(wanted - found), len(wanted)


@pytest.mark.parametrize('by_gyro', [False, True])
def test_good_spots_are_all_followed(clean, gyro, by_gyro):
    """Through rest, slews and the first step, whose motion nobody knows without the gyro."""
    followed = SpotTracker(SCENARIO).follow(clean, gyro if by_gyro else None)
    wrong, made, missed, _ = score(clean, followed.track)
    assert (wrong, missed) == (0, 0) and made > 6000


@pytest.mark.parametrize('by_gyro', [False, True])
@pytest.mark.parametrize('focal_length_mm', [25.5, 23.1])
def test_missing_and_false_spots_mislead_as_often_as_chance_has_it(clean, gyro, by_gyro,
                                                                   focal_length_mm):
    """Purity and completeness, the focal length up to 10 % wrong.

    Wrong: a track of a false spot, or one whose star is missing, finds a false spot in its gate.
    Missed: another spot or track in the gate makes a star and its neighbours in time ambiguous.
    """
    frames = spoiled(clean)
    scenario = SCENARIO.replace({'camera.focal_length_mm': focal_length_mm})
    track = SpotTracker(scenario).follow(frames, gyro if by_gyro else None).track
    wrong, made, missed, wanted = score(frames, track)
    stars = made / len(frames)
    stray = (1 + PATIENCE) * FALSE + MISSING * stars            # tracks without a star's spot
    expected = len(frames) * stray * FALSE * GATE_PART
    assert wrong <= poisson.ppf(0.9999, expected)
    expected = 2 * wanted * (FALSE + (1 + PATIENCE) * FALSE) * GATE_PART
    assert missed <= poisson.ppf(0.9999, expected)
    assert wrong / made < 1e-3 and missed / wanted < 4e-3


def test_turn_is_that_of_the_camera(clean):
    """From the nominal camera, 0.4 % wrong in f: the turn across the axis is as wrong."""
    scenario = SCENARIO.replace({'simulation.duration_s': 60.0})
    frames = clean[:120]
    followed = SpotTracker(scenario).follow(frames)
    C_si = Truth.from_scenario(scenario).attitude_si(frames.stamp_ns)
    turn = C_si[1:] @ np.swapaxes(C_si[:-1], -1, -2)
    error = np.linalg.norm(rotation.log(followed.turn[1:] @ np.swapaxes(turn, -1, -2)), axis=-1)
    size = np.linalg.norm(rotation.log(turn), axis=-1)
    # 20 stars of 0.05 px: about the axis 0.05 sqrt(2) / (300 px sqrt(20)) = 5e-5 rad; 5 sigma
    assert (error <= 0.005 * size + 2.5e-4).all()


def test_batches_do_not_show(clean, gyro):
    frames = spoiled(clean)[:100]
    whole = SpotTracker(SCENARIO).follow(frames, gyro)
    tracker = SpotTracker(SCENARIO)
    parts = [tracker.follow(frames[k:k + 7], gyro) for k in range(0, 100, 7)]
    np.testing.assert_array_equal(np.concatenate([part.track for part in parts]), whole.track)
    np.testing.assert_allclose(np.concatenate([part.turn for part in parts]), whole.turn,
                               atol=1e-12)


def test_silence_of_the_gyro_is_bridged_by_the_motion_seen(clean, gyro):
    silent = gyro.stamp_ns < clean.stamp_ns[60]
    rest = GyroSamples(gyro.stamp_ns[~silent], gyro.rate[~silent])
    track = SpotTracker(SCENARIO).follow(clean, rest).track
    assert score(clean, track)[::2] == (0, 0)


def test_star_that_is_gone_too_long_gets_a_new_number(clean):
    frames = clean[:12]
    hip = frames.catalog_id[0]
    frame = np.repeat(np.arange(12), frames.star_counts)

    def numbers(gone):
        keep = (frames.catalog_id != hip) | (frame < 2) | (frame >= 2 + gone)
        first = np.concatenate(([0], np.cumsum(np.bincount(frame[keep], minlength=12))))
        some = Frames(frames.stamp_ns, first, frames.uv_raster[keep], frames.sigma[keep],
                      frames.magnitude[keep], frames.catalog_id[keep])
        track = SpotTracker(SCENARIO).follow(some).track
        return len(np.unique(track[some.catalog_id == hip]))

    assert [numbers(gone) for gone in (PATIENCE, PATIENCE + 1)] == [1, 2]


def test_ambiguous_spots_are_left_alone(clean):
    """A second spot 2 px beside a star: neither is taken for it, and the others are followed."""
    frames = clean[:2]
    beside = frames.uv_raster[frames.first[1]] + (2.0, 0.0)
    frames = Frames(frames.stamp_ns, frames.first + [0, 0, 1],
                    np.vstack((frames.uv_raster, beside)), np.append(frames.sigma, 0.05),
                    np.append(frames.magnitude, 6.0), np.append(frames.catalog_id, 0))
    track = SpotTracker(SCENARIO).follow(frames).track
    assert track[frames.first[1]] == track[-1] == -1
    assert (track[frames.first[1] + 1:-1] >= 0).all()


@pytest.mark.parametrize('spot', [(np.nan, 3.0), (np.inf, 0.0), (1e300, -1e300)])
def test_spots_that_can_not_be_are_no_tracks(clean, spot):
    frames = clean[:5]
    uv = frames.uv_raster.copy()
    uv[[0, 7, 30]] = spot
    track = SpotTracker(SCENARIO).follow(replace(frames, uv_raster=uv)).track
    assert (track[[0, 7, 30]] == -1).all() and (np.delete(track, [0, 7, 30]) >= 0).all()


def test_frames_without_spots_are_taken():
    empty = Frames(np.arange(3) * 10**9, np.zeros(4, np.int64), np.empty((0, 2)), np.empty(0),
                   np.empty(0), np.empty(0, np.int64))
    tracker = SpotTracker(SCENARIO)
    assert len(tracker.follow(Frames.empty()).track) == 0
    followed = tracker.follow(empty)
    assert len(followed.track) == 0
    np.testing.assert_array_equal(followed.turn, np.broadcast_to(np.eye(3), (3, 3, 3)))
