# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""In-flight calibration of a star tracker and three gyros, after Tan et al. 2018 (T18).

Data flow
---------
::

    images ──► imaging ──► identification ──┐
    simulation (the truth) ─────────────────┤
    recording (MCAP, rosbag2) ──────────────┤
    drivers, over topics ───────────────────┴──► star frames, gyro readings
                                                             │
                                                       measurements
                            ┌────────────────────────────────┤
                            ▼                                ▼
                 filter (all 16 states)         calibration (the camera alone)
                            │                                │
                            └────────► results, report ◄─────┘

`sky` gives all of them the same apparent places, `config` the same parameters. `messages` has what
is on the topics; `nodes` carries it over ROS 2, and `cli` runs the same on files.

The wings
---------
Each imports itself and those before it in this table (``WINGS`` in ``test/test_style.py``). ::

    core            mathematics on arrays: rotations, the camera, Kalman steps, the image of a star
    files           files written whole or not at all, read within limits, kept from run to run
    sky             where the stars are: catalogue, apparent places, refraction
    config          one scenario: every parameter, and the models that are made of it
    measurements    what sensors deliver, in order, and what every calibration makes of it first
    filter          the 16-state filter, the calibrator that runs it on messages, the verdict
    imaging         from the pixels of an image to star centroids
    identification  which star is which: catalogue numbers for centroids
    calibration     the camera alone; `methods` has one method a file
    messages        what is on the topics: their names, the conventions of ROS, CDR bytes
    recording       MCAP files and rosbag2 directories, read and written
    checks          what of a configuration a recording denies, before any filter runs
    results         what a calibration gives: RESULT.json, exports, the store of saved ones
    workflows       whole calibrations of the parts: the bootstrap, still images, the live suite
    simulation      the truth and the sensors that see it; `errors` has one error source a file
    evaluation      how good the estimates are: Cramér-Rao bound, consistency, Monte Carlo
    reproduction    the tables and figures of the papers, beside ours
    report          what a person reads: tables, figures, the page of a calibration
    live            a calibration while it goes on: in the terminal, on a page for browsers
    nodes           the ROS 2 nodes, one a file; `base` has what they share
    cli             the command ``starcal``, one sub-command a file

Truth (`simulation`) and belief (`filter`, `calibration`) share models, never objects: what
estimates stands before the truth and can not import it. Only `nodes` imports rclpy.

The estimator node and ``starcal calibrate`` run the same `filter.calibrator.Calibrator`, and get
the same numbers from the same messages. The Monte Carlo of `evaluation` runs what is inside it,
`filter.error_state.Filter`, on many runs at once (`evaluation.batch`).

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

Signs, time, the frame of every covariance and the words of the project are in
``docs/conventions.md``.
"""

__version__ = '0.2.0'
