# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Files of every kind that is read, to be damaged: for the tests, and for long runs of `bench`."""

from collections.abc import Callable
import json
from pathlib import Path
from typing import NamedTuple

from PIL import Image
from astropy.io import fits
import lz4.frame  # noqa: F401
import mcap.writer
import numpy as np

from instruments import TAN2018
from starcal_ros.config import parameter_file
from starcal_ros.config.parameter import ConfigError
from starcal_ros.files.documents import DocumentError, load_json, load_yaml
from starcal_ros.imaging.files import ImageFileError, load
from starcal_ros.messages.cdr import RecordError
from starcal_ros.messages.cdr_imu import IMU_TYPE, encode_imu
from starcal_ros.messages.cdr_pointcloud import CLOUD_TYPE, encode_centroids
from starcal_ros.recording import reader
from starcal_ros.recording.mcap_check import check_file
from starcal_ros.results.attached_truth import attached_truth
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth
from starcal_ros.workflows.still_images.table import read_centroids

WORDS = [b'[', b']', b'{', b'}', b':', b'"', b'&a ', b'*a', b'- ', b'\n', b',', b'9' * 400, b'-1',
         b'1e999', b'nan', b'null', b'\0', b'\xff', b'\x1b[2J', b'[/x]', b'!!timestamp ', b'<<: ',
         b'\xff\xff\xff\xff\xff\xff\xff\x7f', b'\xff' * 8, bytes(8)]
"""What is put into a file, beside single bytes."""


class Kind(NamedTuple):
    """A kind of file: its name, sound content, what reads it, and the errors that it may give."""

    name: str
    content: bytes
    read: Callable[[Path], object]
    errors: tuple[type[Exception], ...]


def damage(content: bytes, edits: list[tuple[float, int, int]]) -> bytes:
    """Change a file at some places.

    Parameters
    ----------
    content : bytes
    edits : list of (place, how, what)
        The place is a part of the length.
    """
    data = bytearray(content)
    for place, how, what in edits:
        at = int(place * len(data))
        if how == 0:
            data[at:at + 1] = bytes([what % 256])
        elif how == 1:
            data[at:at] = WORDS[what % len(WORDS)]
        elif how == 2:
            word = WORDS[what % len(WORDS)]
            data[at:at + len(word)] = word
        elif how == 3:
            del data[at:at + 1 + what % 64]
        elif how == 4:
            data[at:at] = data[at:at + 1 + what % 64] * (1 + what % 5)
        else:
            del data[at:]
    return bytes(data)


def _mcap(folder: Path, compression: mcap.writer.CompressionType, chunks: bool = True) -> bytes:
    gyro = sensors.gyro(TAN2018).next(60)
    frames = sensors.star_tracker(TAN2018).next(3)
    path = folder / 'sound.mcap'
    with path.open('wb') as stream:
        writer = mcap.writer.Writer(stream, chunk_size=2000, compression=compression,
                                    use_chunking=chunks)
        writer.start('ros2', 'test')
        for topic, type_name, stamps, messages in (
                (reader.GYRO_TOPIC, IMU_TYPE, gyro.stamp_ns, encode_imu(gyro)),
                (reader.FRAMES_TOPIC, CLOUD_TYPE, frames.stamp_ns, encode_centroids(frames))):
            channel = writer.register_channel(
                topic, 'cdr', writer.register_schema(type_name, 'ros2msg', b''),
                {'offered_qos_profiles': '- history: keep_last\n  depth: 5'})
            for stamp, message in zip(stamps.tolist(), messages):
                writer.add_message(channel, stamp, bytes(message), stamp)
        writer.add_attachment(0, 0, 'truth.json', 'application/json', b'{}')
        writer.finish()
    return path.read_bytes()


def _image(folder: Path, name: str) -> bytes:
    y, x = np.mgrid[:24, :32]
    counts = (50.0 + 200.0 * np.exp(-((x - 9)**2 + (y - 9)**2) / 6.0)).astype(np.uint8)
    path = folder / name
    if name.endswith('.fits'):
        fits.PrimaryHDU(counts.astype(np.uint16)).writeto(path)
    else:
        Image.fromarray(counts).save(path)
    return path.read_bytes()


def _recording(path: Path) -> None:
    check_file(path)
    reader.summary(path)
    reader.read(path)


def _bag(path: Path) -> None:
    reader.read(path.parent)


def kinds(folder: Path) -> list[Kind]:
    """Return all kinds; `folder` is for what they are made of."""
    folder.mkdir(exist_ok=True)
    compression = mcap.writer.CompressionType
    truth = json.dumps(Truth.from_scenario(TAN2018).as_dict()).encode()
    stars = 'image,u,v,catalog_id,sigma,split\n' + ''.join(
        f'{k // 4}.png,{k * 9.5},{k * 7.25},{k + 100},0.05,fit\n' for k in range(12))
    record, image = (RecordError,), (ImageFileError,)
    return [
        Kind('zstd.mcap', _mcap(folder, compression.ZSTD), _recording, record),
        Kind('lz4.mcap', _mcap(folder, compression.LZ4), _recording, record),
        Kind('plain.mcap', _mcap(folder, compression.NONE), _recording, record),
        Kind('loose.mcap', _mcap(folder, compression.NONE, False), _recording, record),
        Kind('metadata.yaml', b'rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: '
             b'mcap\n  relative_file_paths: [none.mcap]\n  compression_mode: ""\n', _bag, record),
        Kind('parameters.yaml', parameter_file.dump(TAN2018).encode(), parameter_file.load,
             (ConfigError,)),
        Kind('any.yaml', b'a: &a {b: [1, 2.5, x], c: 2026-01-01}\nd: [*a, *a]\n<<: *a\n',
             lambda path: load_yaml(path.read_bytes().decode(errors='replace')),
             (DocumentError,)),
        Kind('any.json', truth, lambda path: load_json(path.read_bytes()), (DocumentError,)),
        Kind('truth.json', truth, lambda path: attached_truth({'truth.json': path.read_bytes()}),
             ()),
        Kind('stars.csv', stars.encode(), lambda path: read_centroids(path, '2026-01-01'),
             (ConfigError,)),
        *(Kind(name, _image(folder, name), load, image)
          for name in ('a.png', 'a.tif', 'a.jpg', 'a.fits')),
    ]


def is_held(kind: Kind, content: bytes, folder: Path) -> bool:
    """Read a damaged file; tell whether it was refused, in one line, or a line an error.

    Any other error than those of its kind goes on to the caller.
    """
    path = folder / kind.name
    path.write_bytes(content)
    try:
        kind.read(path)
    except kind.errors as error:
        first, *others = str(error).split('\n')
        if not first or others and not (
                kind.name == 'parameters.yaml' and all(line.startswith('  ') for line in others)):
            raise AssertionError(f'not one line: {error}') from error
        return True
    return False
