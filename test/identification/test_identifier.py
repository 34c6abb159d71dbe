# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Star identification: simulated frames with false and missing stars, real ones, bad ones."""

import csv
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import poisson

from instruments import DETECTOR, INTRINSICS, PITCH_MM, REAL_SKY
from starcal_ros.config.image import CentroidConfig
from starcal_ros.core import rotation
from starcal_ros.core.camera import Detector
from starcal_ros.evaluation.identification import Viewer, score
from starcal_ros.identification import patterns as star_patterns
from starcal_ros.identification.camera_guess import CameraGuess
from starcal_ros.identification.identifier import MODEL_SIGMA_PX, Identifier, MirroredError
from starcal_ros.identification.matching import View
from starcal_ros.imaging.centroids import extract
from starcal_ros.imaging.files import image_files, load
from starcal_ros.sky import catalog

pytest.importorskip('tetra3rs')

STAMP_NS = 1_782_993_600_000_000_000
ARCSEC = np.pi / 180.0 / 3600.0


def guess(error: float = 0.01) -> CameraGuess:
    """Return T18's camera, its focal length wrong by a part, the rest unknown."""
    return CameraGuess.of_focal_length(DETECTOR, INTRINSICS[2] * (1.0 + error), 1.2 * abs(error))


def known() -> CameraGuess:
    """Return T18's true camera."""
    return CameraGuess(DETECTOR, INTRINSICS, np.zeros((7, 7)))


def viewer(seed: int, **changes) -> Viewer:
    """Return T18's true camera under the sky."""
    return Viewer(DETECTOR, INTRINSICS, np.random.default_rng(seed), **changes)


def path(eye: Viewer, turn, count: int):
    """Return the frames while the camera turns by `turn` from one to the next."""
    C_si, sights = rotation.exp(np.array([1.0, 2.0, -0.5])), []
    for k in range(count):
        sights.append(eye.at(C_si, STAMP_NS + k * 500_000_000))
        C_si = turn @ C_si
    return sights


# Lost in space

@pytest.mark.parametrize('error, frames', [
    pytest.param(0.01, 60, marks=pytest.mark.slow), (0.1, 40)])
def test_stars_are_found_among_false_and_missing_ones(error, frames):
    """Five false spots a frame, 20 % of the stars missing, a distortion that is not known."""
    identifier, eye = Identifier(guess(error)), viewer(1)
    result = score((eye.anywhere(STAMP_NS) for _ in range(frames)),
                   lambda sight: identifier.lost_in_space(sight.uv_raster, sight.flux, STAMP_NS))
    assert result.found == frames
    assert result.wrong <= 1e-3 * result.named
    # Left out: one in a thousand outside the gate, and stars too near to another one.
    assert result.named > 0.95 * result.stars


def test_the_attitude_is_that_of_the_apparent_places():
    identifier, eye = Identifier(known()), viewer(2, missing=0.0, false=0)
    aberration = []
    for _ in range(5):
        sight = eye.anywhere(STAMP_NS)
        found = identifier.lost_in_space(sight.uv_raster, sight.flux, STAMP_NS)
        error = rotation.log(found.C_si @ sight.C_si.T)
        covariance = (found.view.root @ found.view.root.T)[:3, :3]
        # 99.9 % of chi-square with 3 degrees of freedom, for spots good to 0.05 px that the fit
        # expects to be off by MODEL_SIGMA_PX; twice that, because its weights are not the best.
        assert (error @ np.linalg.solve(covariance, error)
                < 2.0 * 16.3 * (0.05 / MODEL_SIGMA_PX)**2)
        timeless = identifier.lost_in_space(sight.uv_raster, sight.flux)
        aberration.append(np.linalg.norm(rotation.log(timeless.C_si @ sight.C_si.T)))
    # 20.5" times the sine of the angle to the Earth's velocity; near 0 close to the apex only
    assert 10.0 * ARCSEC < max(aberration) < 25.0 * ARCSEC


def test_random_spots_are_no_stars():
    identifier, rng = Identifier(guess(0.1)), np.random.default_rng(3)
    for _ in range(15):
        uv_raster = rng.uniform(0.0, 1023.0, (rng.integers(5, 40), 2))
        assert identifier.lost_in_space(uv_raster, rng.lognormal(size=len(uv_raster))) is None


@pytest.mark.parametrize('seed', range(5))
def test_a_pattern_that_no_other_spot_bears_out_is_chance(seed, monkeypatch):
    """Four spots lie as four stars do, 34 others near no star.

    The attitude is made of two of the four. By Eq. (I.2) two of 38 random spots fall into the
    gates of 100 stars, each pi GATE MODEL_SIGMA_PX^2 at least, once in 50 000 frames or oftener.
    """
    rng, eye = np.random.default_rng(seed), viewer(seed, missing=0.0, false=0, sigma_px=0.0,
                                                   limiting_magnitude=catalog.SHIPPED_LIMIT)
    sight = eye.anywhere(STAMP_NS)
    assert len(sight.flux) > 100
    bright = np.argsort(-sight.flux)
    anywhere = rng.uniform(0.0, 1023.0, (1000, 2))
    far = np.linalg.norm(anywhere[:, None] - sight.uv_raster, axis=-1).min(axis=1) > 15.0
    monkeypatch.setattr(star_patterns, 'search', lambda *_: star_patterns.PatternMatch(
        np.arange(4), sight.hip[bright[:4]], INTRINSICS[2] / PITCH_MM, False))
    identifier = Identifier(known())

    def identify(count):
        spots = np.vstack((sight.uv_raster[bright[:count]], anywhere[far][:34]))
        return identifier.lost_in_space(spots, np.ones(len(spots)), STAMP_NS)

    assert identify(4) is None
    assert identify(12) is not None


def test_a_mirrored_image_is_said_to_be_one():
    identifier, sight = Identifier(guess()), viewer(4).anywhere(STAMP_NS)
    with pytest.raises(MirroredError, match='flip the image'):
        identifier.lost_in_space(sight.uv_raster * [1, -1] + [0, 1023], sight.flux, STAMP_NS)


def test_spots_without_flux_are_identified_by_their_place():
    identifier, sight = Identifier(guess()), viewer(5).anywhere(STAMP_NS)
    bright = np.argsort(-sight.flux)
    flux = sight.flux.copy()
    flux[bright[12:]] = np.nan
    found = identifier.lost_in_space(sight.uv_raster, flux, STAMP_NS)
    named = found.catalog_id != 0
    assert np.array_equal(found.catalog_id[named], sight.hip[named])
    assert named[bright[12:]].sum() > 5


def test_a_bright_spot_on_a_faint_star_is_not_that_star():
    eye = viewer(6, false=0, missing=0.0)
    sight = eye.anywhere(STAMP_NS)
    faintest = int(np.argmin(sight.flux))
    flux = sight.flux.copy()
    flux[faintest] = flux.max()
    found = Identifier(guess()).lost_in_space(sight.uv_raster, flux, STAMP_NS)
    assert found.catalog_id[faintest] == 0 and (found.catalog_id != 0).sum() > len(flux) // 2


@pytest.mark.parametrize('count', [0, 1, 3])
def test_a_frame_of_too_few_spots_is_not_identified(count):
    identifier = Identifier(guess())
    assert identifier.lost_in_space(np.full((count, 2), 500.0), np.ones(count)) is None
    assert identifier.identify(np.full((count, 2), 500.0), np.ones(count), STAMP_NS) is None


def test_spots_that_can_not_be_are_left_out():
    sight = viewer(7).anywhere(STAMP_NS)
    bad = np.array([[np.nan, 5.0], [np.inf, 5.0], [-20.0, 5.0], [100.0, 100.0], [200.0, 200.0]])
    sigma = np.concatenate((np.full(len(sight.hip), 0.05), [0.05, 0.05, 0.05, np.nan, -1.0]))
    found = Identifier(guess()).lost_in_space(
        np.vstack((sight.uv_raster, bad)),
        np.concatenate((sight.flux, np.full(5, sight.flux.max()))), STAMP_NS, sigma)
    assert not found.catalog_id[-5:].any() and found.catalog_id[:-5].any()


# Tracking

@pytest.mark.parametrize('gyro', [True, False])
def test_a_turning_camera_is_tracked(gyro):
    turn = rotation.exp(np.array([0.0, np.radians(1.0) * 0.5, 0.0]))
    identifier, sights = Identifier(guess()), path(viewer(8), turn, 40)
    tracked = []

    def identify(sight):
        found = identifier.identify(sight.uv_raster, sight.flux, sight.stamp_ns,
                                    turn if gyro else None)
        tracked.append(found.tracked)
        return found

    result = score(sights, identify)
    assert result.wrong <= 1e-3 * result.named and result.named > 0.95 * result.stars
    assert tracked == [False] * (1 if gyro else 2) + [True] * (39 if gyro else 38)


def test_few_stars_are_tracked_where_gyros_tell_the_turn():
    """Some six stars a frame are too few to search with, mostly, but enough to follow."""
    turn = rotation.exp(np.array([0.0, 0.0, np.radians(0.5) * 0.5]))
    identifier = Identifier(guess())
    first, *_ = path(viewer(9), turn, 1)
    _, *rest = path(viewer(9, limiting_magnitude=5.2), turn, 30)
    assert identifier.identify(first.uv_raster, first.flux, first.stamp_ns) is not None
    result = score(rest, lambda sight: identifier.identify(sight.uv_raster, sight.flux,
                                                           sight.stamp_ns, turn))
    assert 4 * result.frames < result.stars < 8 * result.frames
    assert result.wrong == 0 and result.named > 0.9 * result.stars


def test_an_attitude_is_searched_for_where_tracking_fails():
    eye, still = viewer(10), np.eye(3)
    identifier = Identifier(guess())
    first, elsewhere = eye.anywhere(STAMP_NS), eye.anywhere(STAMP_NS + 500_000_000)
    identifier.identify(first.uv_raster, first.flux, first.stamp_ns)
    found = identifier.identify(elsewhere.uv_raster, elsewhere.flux, elsewhere.stamp_ns, still)
    assert found is not None and not found.tracked
    named = found.catalog_id != 0
    assert np.array_equal(found.catalog_id[named], elsewhere.hip[named])


def test_an_attitude_outlives_frames_without_stars():
    still = np.eye(3)
    first, later = path(viewer(11), still, 6)[::5]
    identifier = Identifier(guess())
    identifier.identify(first.uv_raster, first.flux, first.stamp_ns)
    for k in range(1, 5):
        assert identifier.identify(np.zeros((0, 2)), np.zeros(0),
                                   first.stamp_ns + k * 100_000_000, still) is None
    assert identifier.identify(later.uv_raster, later.flux, later.stamp_ns, still).tracked


def test_what_is_expected_without_reason_is_not_believed():
    """Ten false spots somewhere near no stars' places: a wide prior finds matches by chance."""
    rng, identifier = np.random.default_rng(12), Identifier(guess())
    camera = guess()
    for _ in range(50):
        prior = View.around(rotation.exp(rng.standard_normal(3)), 2e-3**2 * np.eye(3),
                            camera.intrinsics, camera.covariance)
        assert identifier.track(prior, rng.uniform(0.0, 1023.0, (10, 2)), np.ones(10)) is None


@pytest.mark.slow
def test_random_spots_are_tracked_once_in_ten_thousand_frames_at_most():
    """An attitude known to 6 px: by Eq. (I.2) up to one frame in 25 has three matches."""
    rng, identifier, frames = np.random.default_rng(13), Identifier(known()), 2000
    sigma = 6.0 * PITCH_MM / INTRINSICS[2]
    answers = 0
    for _ in range(frames):
        prior = View.around(rotation.exp(rng.standard_normal(3)), sigma**2 * np.eye(3),
                            INTRINSICS, np.zeros((7, 7)))
        answers += identifier.track(prior, rng.uniform(0.0, 1023.0, (10, 2)),
                                    np.ones(10)) is not None
    assert answers <= poisson.ppf(0.999, 1e-4 * frames)


# The database

def test_the_database_speaks_hipparcos():
    patterns = star_patterns.database(*star_patterns._steps(13.0, 16.0), catalog.SHIPPED_LIMIT)
    stars = catalog.load()
    row = stars.rows([32349, 91262, 71683])         # Sirius, Vega, alpha Centauri A
    for hip, k in zip((32349, 91262, 71683), row):
        star = patterns.get_star_by_id(hip)
        # single precision: 0.02"
        assert star.ra_deg == pytest.approx(np.degrees(stars.ra[k]), abs=3e-5)
        assert star.dec_deg == pytest.approx(np.degrees(stars.dec[k]), abs=3e-5)


def test_near_fields_share_a_database():
    assert star_patterns._steps(13.2, 16.2) == star_patterns._steps(14.5, 15.0)


def test_a_missing_library_is_named(monkeypatch):
    def refuse(name):
        raise ImportError(name)
    monkeypatch.setattr(star_patterns, 'import_module', refuse)
    with pytest.raises(ImportError, match=r"pip install 'starcal_ros\[identify\]'"):
        star_patterns.database(0, 1, 5.0)


# The camera

def test_a_field_is_a_range_of_focal_lengths():
    near, far = CameraGuess.of_field(DETECTOR, 10.0, 20.0).focal_range_px
    assert near == pytest.approx(512.0 / np.tan(np.radians(10.0)))
    assert far == pytest.approx(512.0 / np.tan(np.radians(5.0)))


def test_an_error_of_the_focal_length_is_two_sigma():
    near, far = CameraGuess.of_focal_length(DETECTOR, 25.0, 0.1).focal_range_px
    assert [near, far] == pytest.approx([22.5 / PITCH_MM, 27.5 / PITCH_MM])


def test_a_camera_of_unknown_field_is_identified():
    detector = Detector(1024, 1024, 1.0)            # pitch unknown: all in pixels
    sight = viewer(13).anywhere(STAMP_NS)
    found = Identifier(CameraGuess.of_field(detector, 12.0, 17.0)).lost_in_space(
        sight.uv_raster, sight.flux)
    assert found.view.intrinsics[2] == pytest.approx(25.6 / PITCH_MM, rel=2e-3)


@pytest.mark.parametrize('make, text', [
    (lambda: CameraGuess.of_focal_length(DETECTOR, -1.0, 0.1), 'focal length -1.0 mm: a positive'),
    (lambda: CameraGuess.of_focal_length(DETECTOR, np.nan, 0.1), 'focal length nan mm'),
    (lambda: CameraGuess.of_focal_length(DETECTOR, 25.0, 1.0), 'error 1.0 of the focal length'),
    (lambda: CameraGuess.of_field(DETECTOR, 20.0, 10.0), 'field of 20.0 to 10.0 deg'),
    (lambda: CameraGuess.of_field(DETECTOR, 0.0, 10.0), 'field of 0.0 to 10.0 deg'),
])
def test_an_impossible_camera_is_refused(make, text):
    with pytest.raises(ValueError, match=text):
        make()


# The real sky

def test_real_stars_are_those_that_others_found():
    """11 images of tomc16, saturated stars left out: the brightest are not among the spots."""
    if not REAL_SKY.is_dir():
        pytest.skip(f'{REAL_SKY} is not there')
    with (REAL_SKY / 'tomc16' / 'stars.csv').open() as stream:
        rows = [SimpleNamespace(**row) for row in csv.DictReader(stream)]
    identifier = Identifier(CameraGuess.of_field(Detector(808, 608, 1.0), 13.0, 15.5))
    named = 0
    for image in sorted({row.image for row in rows}):
        stars = [row for row in rows if row.image == image]
        found = identifier.lost_in_space(
            np.array([[row.u, row.v] for row in stars], float),
            np.array([row.flux_adu for row in stars], float))
        assert found is not None, image
        hip = np.array([row.catalog_id for row in stars], int)
        told = found.catalog_id != 0
        assert np.array_equal(found.catalog_id[told], hip[told]), image
        named += told.sum()
    assert named > 0.95 * len(rows)


def test_real_images_are_identified():
    """Orion over the lit horizon, the Milky Way, refraction of 2 px: nine images of granasat."""
    if not REAL_SKY.is_dir():
        pytest.skip(f'{REAL_SKY} is not there')
    with (REAL_SKY / 'granasat' / 'stars.csv').open() as stream:
        rows = [SimpleNamespace(**row) for row in csv.DictReader(stream)]
    identifier = Identifier(CameraGuess.of_field(Detector(1280, 960, 1.0), 25.5, 29.0))
    for path in image_files(REAL_SKY / 'granasat'):
        picture = load(path)
        stars = extract(picture.counts, CentroidConfig(), picture.scale)
        found = identifier.lost_in_space(stars.uv_raster, stars.flux, sigma=stars.sigma)
        assert found is not None and (found.catalog_id != 0).sum() > 25, path.name
        uv = np.array([[row.u, row.v] for row in rows if row.image == path.name], float)
        hip = np.array([row.catalog_id for row in rows if row.image == path.name], int)
        distance = np.linalg.norm(stars.uv_raster - uv[:, None], axis=-1)
        of, near = distance.argmin(axis=1), distance.min(axis=1) < 0.5
        told = near & (found.catalog_id[of] != 0)
        assert told.sum() > 0.9 * near.sum(), path.name
        assert np.array_equal(found.catalog_id[of][told], hip[told]), path.name
