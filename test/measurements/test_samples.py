# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gyro samples and frames: cutting and joining loses nothing."""

from dataclasses import fields

import numpy as np
import pytest

from starcal_ros.measurements.samples import Frames, GyroSamples


def same(a, b):
    """Tell whether two batches hold the same arrays, of the same types."""
    return all(getattr(a, field.name).dtype == getattr(b, field.name).dtype
               and np.array_equal(getattr(a, field.name), getattr(b, field.name))
               for field in fields(a))


@pytest.fixture
def gyro():
    return GyroSamples(np.arange(7) * 10**7, np.arange(21.0).reshape(7, 3))


@pytest.fixture
def frames():
    """Return five frames of 3, 0, 2, 0 and 1 stars."""
    n = 6
    return Frames(np.arange(5) * 10**9, np.array([0, 3, 3, 5, 5, 6]),
                  np.arange(2.0 * n).reshape(n, 2), np.arange(n) / 10, np.arange(n) / 2,
                  100 + np.arange(n))


def test_a_frame_owns_its_stars(frames):
    assert len(frames) == 5
    assert frames.star_counts.tolist() == [3, 0, 2, 0, 1]
    third = frames[2:3]
    assert third.stamp_ns.tolist() == [2 * 10**9]
    assert third.first.tolist() == [0, 2]
    assert third.catalog_id.tolist() == [103, 104]
    assert third.uv_raster.tolist() == [[6.0, 7.0], [8.0, 9.0]]
    assert third.sigma.tolist() == [0.3, 0.4]
    assert third.magnitude.tolist() == [1.5, 2.0]


@pytest.mark.parametrize('cuts', [(), (2,), (1, 1, 4), (0, 5), range(1, 5)])
def test_frames_cut_and_joined_are_the_same(frames, cuts):
    edges = [0, *cuts, 5]
    parts = [frames[low:high] for low, high in zip(edges, edges[1:])]
    assert same(Frames.concatenate(parts), frames)


@pytest.mark.parametrize('cuts', [(), (2,), (1, 1, 4), (0, 7)])
def test_samples_cut_and_joined_are_the_same(gyro, cuts):
    edges = [0, *cuts, 7]
    parts = [gyro[low:high] for low, high in zip(edges, edges[1:])]
    assert same(GyroSamples.concatenate(parts), gyro)
    assert sum(map(len, parts)) == len(gyro)


@pytest.mark.parametrize('rows', [slice(3, 1), slice(5, 9), slice(-20, -10), slice(9, None)])
def test_frames_outside_are_none(frames, rows):
    assert same(frames[rows], Frames.empty())


@pytest.mark.parametrize('rows, stamps', [
    (slice(-2, None), [3, 4]), (slice(None, -3), [0, 1]), (slice(None), [0, 1, 2, 3, 4]),
    (slice(4, 99), [4])])
def test_frames_are_sliced_like_a_list(frames, rows, stamps):
    cut = frames[rows]
    assert (cut.stamp_ns // 10**9).tolist() == stamps
    assert cut.first[0] == 0 and cut.first[-1] == len(cut.uv_raster) == cut.star_counts.sum()


@pytest.mark.parametrize('step', [2, -1])
def test_frames_refuse_a_step(frames, step):
    with pytest.raises(ValueError, match=f'^frames are sliced with step 1, not {step}$'):
        frames[::step]


@pytest.mark.parametrize('kind', [GyroSamples, Frames])
def test_nothing_joined_is_empty(kind):
    assert len(kind.empty()) == 0
    assert same(kind.concatenate([]), kind.empty())
    assert same(kind.concatenate([kind.empty(), kind.empty()]), kind.empty())


def test_empty_batches_do_not_show(gyro, frames):
    assert same(GyroSamples.concatenate([GyroSamples.empty(), gyro, GyroSamples.empty()]), gyro)
    assert same(Frames.concatenate([Frames.empty(), frames, Frames.empty()]), frames)


def test_frames_are_taken_in_any_order_with_their_stars(frames):
    taken = frames.take(np.array([4, 1, 0]))
    assert (taken.stamp_ns // 10**9).tolist() == [4, 1, 0]
    assert taken.first.tolist() == [0, 1, 1, 4]
    assert taken.catalog_id.tolist() == [105, 100, 101, 102]
    assert same(frames.take(np.array([True, False, True, True, False])),
                Frames.concatenate([frames[:1], frames[2:4]]))
    assert same(frames.take(np.zeros(5, bool)), Frames.empty())
