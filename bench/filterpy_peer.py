# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The same calibration written with rosbags and filterpy: `python bench/filterpy_peer.py`.

An hour of T18's scenario is simulated; `starcal calibrate` and the peer below each take it, from
the start of a process to the estimate, one after the other and in turns. The peer reads with
rosbags and steps filterpy's extended Kalman filter with analytic Jacobians and arrays wherever
they are natural: plainly, which is a prediction a gyro reading, and composed, which is one a star
frame. It has no gate, no tests of the model, no check before and no report; the directions of the
stars, and the camera with its derivatives, are those of this package, all stars at once. Needs
filterpy: ``pip install filterpy``.

Forty times is aimed at, of the peer that predicts at each reading. It is out of reach: an hour
has 7200 frames, which at the 90 us that one is allowed are 0.65 s; where the peer takes 30 s, a
fortieth is 0.76 s, and Python with numba and the kernel takes more than what is left to be there.
"""

import argparse
import json
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from bars import noted, told
from filterpy.kalman import ExtendedKalmanFilter
import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from starcal_ros.config import parameter_file
from starcal_ros.config.shipped import config_file
from starcal_ros.core import camera
from starcal_ros.core.units import DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import Observer, apparent_places

HOURS = 1.0
TURNS = 3
WAYS = {'plainly': ['--plainly'], 'composed': []}
AIM = 40.0              # times as long
NOT_YET = 3             # status of a calibration that has not converged yet


def skew(v):
    """Return [v x]."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def messages(bag):
    """Return stamps and rates of the gyro, and stamp, centroids and numbers of each frame."""
    stamps, rates, frames = [], [], []
    with AnyReader([Path(bag)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        wanted = [each for each in reader.connections if each.topic.lstrip('/') in (
            'imu/data_raw', 'star_tracker/centroids')]
        for connection, _, raw in reader.messages(connections=wanted):
            message = reader.deserialize(raw, connection.msgtype)
            at = message.header.stamp
            stamp = at.sec * 10**9 + at.nanosec
            if connection.msgtype == 'sensor_msgs/msg/Imu':
                stamps.append(stamp)
                rate = message.angular_velocity
                rates.append((rate.x, rate.y, rate.z))
            else:
                fields = np.dtype({
                    'names': [each.name for each in message.fields],
                    'formats': [{5: '<i4', 6: '<u4', 7: '<f4', 8: '<f8'}[each.datatype]
                                for each in message.fields],
                    'offsets': [each.offset for each in message.fields],
                    'itemsize': message.point_step})
                stars = np.frombuffer(message.data, fields)
                frames.append((stamp, np.stack((stars['u'], stars['v']), axis=-1).astype(float),
                               stars['catalog_id'].astype(np.int64)))
    return np.array(stamps), np.array(rates), frames


def composed(steps):
    """Return the turns and the effects of a bias on them, piece by piece, as one piece."""
    Delta, J, whole = np.eye(3), np.zeros((3, 3)), 0.0
    for step, of_bias, seconds in steps:
        J += Delta.T @ of_bias
        Delta = step @ Delta
        whole += seconds
    return [(Delta, J, whole)]


def calibrate(bag, plainly):
    """Return bias [deg/h], and intrinsics, with their standard deviations."""
    scenario = parameter_file.load(config_file('tan2018.yaml'))
    options, pitch = scenario.estimator.initial_sigma, scenario.camera.pixel_pitch_mm
    centre = 0.5 * np.array([scenario.camera.width, scenario.camera.height]) - 0.5
    stamps, rates, frames = messages(bag)
    stars = catalog.load_containing(np.concatenate([each[2] for each in frames]))
    u_all = apparent_places(stars, stars.rows(np.concatenate([each[2] for each in frames])),
                            np.array([each[0] for each in frames]),
                            [len(each[2]) for each in frames], Observer())
    first = np.cumsum([0, *(len(each[2]) for each in frames)])
    C_sg = Rotation.from_quat(scenario.mounting.quaternion_xyzw).as_matrix()
    bias = np.zeros(3)
    intrinsics = np.array([*scenario.camera.principal_point_px, scenario.camera.focal_length_mm,
                           *scenario.camera.distortion])
    kf = ExtendedKalmanFilter(dim_x=16, dim_z=2)
    kf.x = np.zeros(16)
    kf.P = np.diag(np.array([
        *(1.0 * DEG,) * 3, *(options.gyro_bias_deg_h * DEG_PER_HOUR,) * 3,
        *(options.fixed_angles_arcsec * DEG / 3600.0,) * 3, *(options.principal_point_px,) * 2,
        options.focal_length_mm, options.k1, options.k2, options.p1, options.p2])**2)
    walk = (scenario.gyro.arw_deg_sqrt_h * DEG_PER_SQRT_HOUR)**2
    C_si = before = None
    for k, (stamp, uv, _) in enumerate(frames):
        u_i = u_all[first[k]:first[k + 1]]
        if C_si is None:
            r_s = camera.unproject(uv - centre, intrinsics, pitch)
            C_si = Rotation.align_vectors(r_s, u_i)[0].as_matrix()
        else:
            rows = np.arange(*np.searchsorted(stamps, (before, stamp), side='right'))
            ends = np.append(stamps[rows], stamp)
            dt = np.diff(ends, prepend=before) * 1e-9
            theta = (rates[np.minimum(np.append(rows, rows[-1] + 1), len(rates) - 1)]
                     - bias) * dt[:, None]
            steps = ((step, (np.eye(3) + 0.5 * skew(angle)) * seconds, seconds)
                     for step, angle, seconds in zip(
                         Rotation.from_rotvec(-theta).as_matrix(), theta, dt))
            for Delta, J, seconds in steps if plainly else composed(steps):
                C_s1s0 = C_sg @ Delta @ C_sg.T
                kf.F = np.eye(16)
                kf.F[:3, :3] = C_s1s0
                kf.F[:3, 3:6] = C_s1s0 @ C_sg @ J
                kf.F[:3, 6:9] = np.eye(3) - C_s1s0
                kf.Q = block_diag(walk * seconds * np.eye(3), np.zeros((13, 13)))
                kf.predict()
                C_si = C_s1s0 @ C_si
        before = stamp
        predicted, H_s, H_lens = camera.linearize(u_i @ C_si.T, intrinsics, pitch)
        H = np.zeros((2 * len(uv), 16))
        H[:, :3] = H_s.reshape(-1, 3)
        H[:, 9:] = H_lens.reshape(-1, 7)
        z = (predicted - (uv - centre)).ravel()
        kf.update(z, lambda x: H, lambda x: H @ x,
                  R=scenario.star_tracker.centroid_sigma_px**2 * np.eye(len(z)))
        C_si = Rotation.from_rotvec(-kf.x[:3]).as_matrix() @ C_si
        C_sg = Rotation.from_rotvec(-kf.x[6:9]).as_matrix() @ C_sg
        bias = bias - kf.x[3:6]
        intrinsics = intrinsics - kf.x[9:]
        kf.x = np.zeros(16)
    sigma = np.sqrt(np.diag(kf.P))
    return {'gyro_bias_deg_h': (bias / DEG_PER_HOUR).tolist(), 'intrinsics': intrinsics.tolist(),
            'sigma': [*(sigma[3:6] / DEG_PER_HOUR).tolist(), *sigma[9:].tolist()]}


def seconds(*arguments):
    """Return how long a process takes, and what it printed."""
    begin = time.monotonic()
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True)
    if done.returncode not in (0, NOT_YET):
        raise SystemExit(done.stderr)
    return time.monotonic() - begin, done.stdout


def main():
    """Measure both."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--peer', metavar='BAG', help='run the peer alone, and print its estimate')
    parser.add_argument('--plainly', action='store_true', help='a prediction a gyro reading')
    given = parser.parse_args()
    if given.peer:
        print(json.dumps(calibrate(given.peer, given.plainly)))
        return
    with tempfile.TemporaryDirectory() as folder:
        bag, out = f'{folder}/t18.mcap', f'{folder}/r.json'
        seconds('-m', 'starcal_ros.cli', 'simulate', '--duration', str(3600.0 * HOURS),
                '--out', bag)
        ours, peers = [], {way: [] for way in WAYS}
        estimates = {}
        for _ in range(TURNS):
            ours.append(seconds('-m', 'starcal_ros.cli', 'calibrate', bag, '--out', out,
                                '--overwrite')[0])
            for way, took in peers.items():
                more, printed = seconds(__file__, '--peer', bag, *WAYS[way])
                took.append(more)
                estimates[way] = json.loads(printed)
        found = json.loads(Path(out).read_text())
    values = [*found['gyro_bias_deg_h'],
              *(found['intrinsics'][key] for key in camera.INTRINSICS_KEYS)]
    print(f'starcal calibrate {min(ours):6.2f} s, with its check and tests')
    for way, took in peers.items():
        peer = estimates[way]
        off = np.abs(np.array(values) - [*peer['gyro_bias_deg_h'], *peer['intrinsics']])
        print(f'peer, {way:<11} {min(took):6.2f} s, {min(took) / min(ours):4.1f} times as long; '
              f'the estimates differ by at most {(off / peer["sigma"]).max():.2f} sigma')
    plainly_s = min(peers['plainly'])
    noted(f'rosbags + filterpy, {HOURS:.0f} h', f'{plainly_s:.1f} s')
    told(f'rosbags + filterpy, {HOURS:.0f} h, over starcal calibrate', plainly_s / min(ours), AIM,
         'times', least=True)


if __name__ == '__main__':
    main()
