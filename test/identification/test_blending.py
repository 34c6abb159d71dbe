# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Blends are known by the catalogue and the trail, and get no name."""

import numpy as np
import pytest

from instruments import DETECTOR, INTRINSICS, PITCH_MM
from starcal_ros.core import camera, rotation
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.identification.blending import photocentre_shift
from starcal_ros.identification.camera_guess import CameraGuess
from starcal_ros.identification.identifier import Identifier
from starcal_ros.identification.star_field import StarField
from starcal_ros.sky.apparent import Observer

STAMP_NS, PERIOD_NS, EXPOSURE_S = 1_782_993_600_000_000_000, 500_000_000, 0.2
STAR, NEIGHBOUR = 62807, 62819      # 3.8 px apart in T18's camera, 0.6 magnitudes
ALONG, ACROSS = 0.0, np.pi / 2.0


def test_a_spot_is_shifted_to_the_photocentre():
    uv = np.array([(0.0, 0.0), (2.0, 0.0), (50.0, 0.0), (0.0, 4.0)])
    magnitude = np.array([6.0, 6.0, 5.0, 6.0])
    at_rest, trails = np.zeros((4, 2)), np.tile((0.0, 5.0), (4, 1))

    def shift(trail, *seen):
        return photocentre_shift(uv, magnitude, trail, np.array(seen))

    assert shift(at_rest, 0) == pytest.approx(np.array([(1.0, 0.0)]))
    assert shift(trails, 0) == pytest.approx(np.array([(2.0, 4.0)]) / 3.0)
    assert not shift(trails, 0, 1, 2, 3).any()      # each has its own spot


@pytest.mark.parametrize('angle, named', [(ALONG, False), (ACROSS, True), (None, True)],
                         ids=['along', 'across', 'at rest'])
def test_a_star_whose_trail_meets_that_of_another_gets_no_name(angle, named):
    pytest.importorskip('tetra3rs')
    sky = StarField(Observer(), 8.0)
    star, neighbour = sky.places(np.array([STAR, NEIGHBOUR]), STAMP_NS)
    x = neighbour - star * (star @ neighbour)
    x /= np.linalg.norm(x)
    C_si = np.array([x, np.cross(star, x), star])       # the star ahead, the neighbour along u
    turn = np.eye(3) if angle is None else rotation.exp(
        np.radians(0.25) * np.array([-np.sin(angle), np.cos(angle), 0.0]))
    identifier = Identifier(CameraGuess(DETECTOR, INTRINSICS, np.zeros((7, 7))),
                            exposure_s=EXPOSURE_S)
    for k in range(-3, 1):
        attitude = np.linalg.matrix_power(turn, 3 + k) @ np.linalg.matrix_power(turn.T, 3) @ C_si
        field = sky.on(DETECTOR, Tan2018Lens(PITCH_MM), attitude, INTRINSICS,
                       STAMP_NS + k * PERIOD_NS, 60)
        uv = camera.project(field.u_i @ attitude.T, INTRINSICS, PITCH_MM)
        kept = DETECTOR.contains(uv) & (field.hip != NEIGHBOUR)
        found = identifier.identify(uv[kept] + DETECTOR.centre_raster,
                                    10.0**(-0.4 * field.magnitude[kept]),
                                    STAMP_NS + k * PERIOD_NS, None, 0.05)
    assert (STAR in found.catalog_id) == named
    assert np.count_nonzero(found.catalog_id) > 40
