# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""In-flight calibration of a star tracker and three gyros, after Tan et al. 2018 (T18).

Data flow
---------
::

    catalog ── sky ──┬── simulation/ ──── messages ──┐
                     │   (truth)                     ├── stream ── estimator ── result ── report
                     └── (apparent places) ──────────┘   (order)   (16 states)

    record   recordings to arrays and back           nodes/  the same over ROS 2 topics
    config   one scenario, every parameter           cli     the command `starcal`

Truth (`simulation`) and belief (`stream`, `estimator`) share models, never objects. Only `nodes`
imports rclpy. The live estimator node, ``starcal calibrate`` and a Monte Carlo run the same
`stream.Calibrator` and `estimator.Filter`.

Frames
------
::

    i  ICRS                          frame_id icrf
    g  gyro axes                     frame_id gyro
    s  star tracker, T18 Fig. 1      (in the core only)
    o  ROS optical, x right, y down  frame_id star_tracker_optical;  r_o = Rz(180 deg) r_s

``C_ab`` takes components in b to components in a; quaternions are (x, y, z, w). Vectors are rows:
``r_s = r_g @ C_sg.T``.

Units
-----
SI and radians; mm for focal length and pixel pitch; pixels from the centre of the detector inside,
raster pixels (``uv_raster``) on topics. Anything else wears its unit in its name.

Where to look
-------------
Mathematics: `rotation`, `camera`, `kalman`, `preintegration`. The sky: `catalog`, `sky`, `places`.
The filter: `estimator`, `acquisition`, `stream`, `timeline`, its options `process_noise`,
`augmentation`; what its covariance means: `verdict`, `evaluation`.
The camera alone: `calibration`, one method a file, on `attitude_free` and `invariants` (single
frames), `interstar`, `interstar_fit` and `spots` (unidentified spots), `bundle`; images of the sky
in files: `plate_images`, through the air: `plate_air`, `refraction`; the stars of still images:
`plates`; cameras of the papers: `published_cameras`; all of it in a row: `bootstrap`.
Images: `simulation.render`, `imaging.centroid`, `imaging.identify`; what they share: `spot`;
live: `imaging.frame`, `numbering`.
Conversions to ROS conventions: `ros_conventions`. Calibrations kept: `archive`, `restart`,
`export`.
"""

__version__ = '0.1.0'
