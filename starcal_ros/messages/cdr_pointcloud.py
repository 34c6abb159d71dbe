# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Star frames to and from CDR: sensor_msgs/PointCloud2, many messages at once.

::

    PointCloud2   sec i4 | nanosec u4 | frame_id | height u4 | width u4 |
                  fields: count u4, each name, offset u4, datatype u1, count u4 |
                  is_bigendian u1 | point_step u4 | row_step u4 | data: length u4, bytes |
                  is_dense u1

Readers go by the names of the fields, never by their offsets. All from the fields to
``point_step`` is the same in every message of a sender, but for the padding, which Fast CDR
leaves as it finds it: it is parsed once, and the messages that share it are read together.
"""

from __future__ import annotations

from dataclasses import dataclass
import struct

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core.arrays import Ints, Mask
from starcal_ros.measurements.samples import Frames
from starcal_ros.messages.cdr import (ENCAPSULATION, HEADER, ByteOrder, Messages, RecordError,
                                      by_byte_order, gather, header_stamp_ns, require)

CLOUD_TYPE = 'sensor_msgs/msg/PointCloud2'

_NUMERIC = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
_FIELDS = {'u': 'f8', 'v': 'f8', 'sigma': 'f4', 'magnitude': 'f4', 'catalog_id': 'u4'}
_POINT = np.dtype([(name, f'<{kind}') for name, kind in _FIELDS.items()])
_ID = np.dtype('u4')
_LARGEST_ID = 2.0**53          # NaN is not below it either
_WHEN_MISSING = {'sigma': 0.0, 'magnitude': np.nan, 'catalog_id': 0}
_SHAPE = np.dtype([('height', 'u4'), ('width', 'u4')])
_DATA = np.dtype([('row_step', 'u4'), ('length', 'u4')])


@dataclass(frozen=True)
class _Layout:
    """What one sender's clouds have in common, from `fields` to `point_step`."""

    encoded: NDArray[np.uint8]
    meaningful: Ints       # the bytes of it that are not padding
    point: np.dtype[np.void]
    names: tuple[str, ...]


def encode_centroids(frames: Frames, frame_id: str = 'star_tracker_optical') -> list[bytes]:
    """Encode star frames as sensor_msgs/PointCloud2, one little-endian message a frame.

    A point is `u`, `v` float64 raster pixels, `sigma` float32 px, `magnitude` float32 and
    `catalog_id` uint32, packed; the cloud is one row and dense.
    """
    points = np.empty(len(frames.uv_raster), _POINT)
    points['u'], points['v'] = frames.uv_raster.T
    points['sigma'], points['magnitude'] = frames.sigma, frames.magnitude
    points['catalog_id'] = frames.catalog_id
    name = _string(frame_id)
    fields = _encode_fields()
    messages = []
    for stamp_ns, low, high in zip(frames.stamp_ns.tolist(), frames.first[:-1], frames.first[1:]):
        data = points[low:high].tobytes()
        messages.append(b''.join((
            b'\0\1\0\0', struct.pack('<iI', *divmod(stamp_ns, 10**9)), name,
            struct.pack('<II', 1, high - low), fields, struct.pack('<II', len(data), len(data)),
            data, b'\1')))
    return messages


def decode_centroids(messages: Messages) -> Frames:
    """Decode sensor_msgs/PointCloud2 to star frames, one a message, in the same order.

    `u` and `v` are needed, of any numeric datatype; `sigma`, `magnitude` and `catalog_id` are
    0, NaN and 0 where the sender has no such field. Points that are not finite are kept.

    Raises
    ------
    RecordError
        If a message is too short for its own content, is not plain CDR, or lacks `u` or `v`.
    """
    stamp_ns = np.empty(len(messages), np.int64)
    counts = np.zeros(len(messages), np.int64)
    parts = []
    for rows, order in by_byte_order(messages):
        start = messages.start[rows] + ENCAPSULATION
        size = messages.size[rows] - ENCAPSULATION
        require(size, HEADER.itemsize, CLOUD_TYPE)
        header = gather(messages.data, start, HEADER.newbyteorder(order))
        stamp_ns[rows] = header_stamp_ns(header)
        shape = HEADER.itemsize + header['frame_id_length'].astype(np.int64) + 3 & ~3
        require(size, shape + _SHAPE.itemsize, CLOUD_TYPE)
        while rows.size:
            begin = start[0] + shape[0] + _SHAPE.itemsize
            layout = _parse_layout(messages.data[begin:start[0] + size[0]].tobytes(), order)
            same = _shares(layout, messages.data, start, shape, size)
            counts[rows[same]], points = _read_points(
                layout, order, messages.data, start[same], shape[same], size[same])
            if len(points):
                parts.append((rows[same], points))
            rows, start, shape, size = (x[~same] for x in (rows, start, shape, size))
    return _assemble(stamp_ns, counts, parts)


def with_catalog_ids(message: bytes, catalog_id: Ints) -> bytes:
    """Return a cloud with these Hipparcos numbers and all else as it was.

    A cloud without a field `catalog_id` gets one at the end of its points, and then has no
    padding between rows.

    Parameters
    ----------
    message : bytes
        A cloud of n points that `decode_centroids` can read.
    catalog_id : (n,) int64 array
        Row by row.

    Raises
    ------
    RecordError
        If its field `catalog_id` can not hold the numbers.
    """
    if not len(catalog_id):
        return message
    order: ByteOrder = '<' if message[1] else '>'
    (length,) = struct.unpack_from(f'{order}I', message, ENCAPSULATION + HEADER.itemsize - 4)
    shape = ENCAPSULATION + (HEADER.itemsize + length + 3 & ~3)
    height, width = struct.unpack_from(f'{order}II', message, shape)
    fields = shape + _SHAPE.itemsize
    layout = _parse_layout(message[fields:], order)
    data, step = fields + len(layout.encoded) + _DATA.itemsize, layout.point.itemsize
    row_step, length = struct.unpack_from(f'{order}II', message, data - _DATA.itemsize)
    changed, number = bytearray(message), catalog_id.reshape(height, width)
    points: NDArray[np.void] = np.ndarray((height, width), layout.point, changed, data,
                                          (row_step, step))
    if 'catalog_id' in layout.names:
        kind = layout.point['catalog_id']
        if kind.itemsize < _ID.itemsize:
            raise RecordError(f"the field 'catalog_id' of a {CLOUD_TYPE} is {kind.name}, too "
                              'small for a Hipparcos number')
        points['catalog_id'] = number
        return bytes(changed)
    kind = _ID.newbyteorder('>' if layout.encoded[-8] else '<')
    appended = np.empty((height, width), [('point', f'V{step}'), ('catalog_id', kind)])
    appended['point'], appended['catalog_id'] = points.view(f'V{step}'), number
    step = appended.itemsize
    return b''.join((
        message[:fields], struct.pack(f'{order}I', len(layout.names) + 1),
        layout.encoded[4:-8].tobytes(), _string('catalog_id', order),
        struct.pack(f'{order}IB3xI', layout.point.itemsize, 6, 1),
        layout.encoded[-8:-4].tobytes(),
        struct.pack(f'{order}III', step, step * width, appended.nbytes), appended.tobytes(),
        message[data + length:]))


def _string(text: str, order: ByteOrder = '<') -> bytes:
    """Encode a string where the stream is aligned to 4, and align it again."""
    content = text.encode() + b'\0'
    return struct.pack(f'{order}I', len(content)) + content + bytes(-len(content) % 4)


def _encode_fields() -> bytes:
    """Encode all from `fields` to `point_step` of the clouds that we send."""
    codes = {kind: code for code, kind in _NUMERIC.items()}
    encoded, offset = struct.pack('<I', len(_FIELDS)), 0
    for name, kind in _FIELDS.items():
        encoded += _string(name) + struct.pack('<IB3xI', offset, codes[kind], 1)
        offset += np.dtype(kind).itemsize
    return encoded + struct.pack('<B3xI', 0, offset)


def _parse_layout(encoded: bytes, order: ByteOrder) -> _Layout:
    """Parse `fields`, `is_bigendian` and `point_step` at the start of some bytes."""
    try:
        (n_fields,), position = struct.unpack_from(f'{order}I', encoded), 4
        present: dict[str, tuple[int, int]] = {}
        spans = [(0, 4)]
        for _ in range(n_fields):
            (length,) = struct.unpack_from(f'{order}I', encoded, position)
            name = encoded[position + 4:position + 3 + length].decode(errors='replace')
            spans.append((position, position + 4 + length))
            position = position + 4 + length + 3 & ~3
            present[name] = struct.unpack_from(f'{order}IB', encoded, position)
            spans += [(position, position + 5), (position + 8, position + 12)]
            position += 12
        is_bigendian, point_step = struct.unpack_from(f'{order}B3xI', encoded, position)
        spans += [(position, position + 1), (position + 4, position + 8)]
    except struct.error:
        raise RecordError(f'the fields of a {CLOUD_TYPE} run past its end: '
                          f'{len(encoded)} bytes are left for them') from None
    if point_step >= 2**31:
        raise RecordError(f'a point_step of {point_step} bytes in a {CLOUD_TYPE}')
    wanted = {name: present[name] for name in _FIELDS if name in present}
    for name, (offset, code) in wanted.items():
        if code not in _NUMERIC:
            raise RecordError(f"the field '{name}' has datatype {code}, not 1 to 8")
        if offset + np.dtype(_NUMERIC[code]).itemsize > point_step:
            raise RecordError(f"the field '{name}' at offset {offset} does not fit into a point "
                              f'of {point_step} bytes')
    byte_order = '>' if is_bigendian else '<'
    point = np.dtype({
        'names': list(wanted),
        'formats': [byte_order + _NUMERIC[code] for _, code in wanted.values()],
        'offsets': [offset for offset, _ in wanted.values()], 'itemsize': point_step})
    return _Layout(np.frombuffer(encoded[:position + 8], np.uint8),
                   np.concatenate([np.arange(*span) for span in spans]), point, tuple(present))


def _shares(layout: _Layout, data: NDArray[np.uint8], start: Ints,
            shape: Ints, size: Ints) -> Mask:
    """Tell which messages have this layout, (n,) bool."""
    begin = shape + _SHAPE.itemsize
    same = size >= begin + len(layout.encoded)
    found = gather(data, (start + begin)[same], np.dtype([('e', 'u1', len(layout.encoded))]))['e']
    same[same] = (found == layout.encoded)[:, layout.meaningful].all(axis=1)
    return same


def _read_points(layout: _Layout, order: ByteOrder, data: NDArray[np.uint8],
                 start: Ints, shape: Ints, size: Ints,
                 ) -> tuple[Ints, NDArray[np.void]]:
    """Read the clouds of one layout: points in each, (n,), and the points end to end."""
    height, width = _columns(gather(data, start + shape, _SHAPE.newbyteorder(order)))
    tail = shape + _SHAPE.itemsize + len(layout.encoded)
    require(size, tail + _DATA.itemsize, CLOUD_TYPE)
    row_step, length = _columns(gather(data, start + tail, _DATA.newbyteorder(order)))
    first = tail + _DATA.itemsize
    require(size, first + length, CLOUD_TYPE)

    step = layout.point.itemsize
    filled = (height > 0) & (width > 0)
    if filled.any():
        for name in ('u', 'v'):
            if name not in (layout.point.names or ()):
                raise RecordError(f"no field '{name}' in a {CLOUD_TYPE}; "
                                  f"it has {', '.join(layout.names) or 'no fields'}")
    needed = (height - 1.0) * row_step + width * float(step)
    overlap = (height > 1) & (row_step < width * float(step))
    bad = np.flatnonzero(filled & ((needed > length) | overlap))
    if bad.size:
        k = bad[0]
        raise RecordError(f'{height[k]} rows of {width[k]} points of {step} bytes, row_step '
                          f'{row_step[k]}, do not fit into {length[k]} bytes of points')
    counts = np.where(filled, height * width, 0)
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    row, column = np.divmod(within, np.repeat(width, counts))
    position = np.repeat(start + first, counts) + row * np.repeat(row_step, counts) + column * step
    return counts, gather(data, position, layout.point)


def _columns(table: NDArray[np.void]) -> list[Ints]:
    return [table[name].astype(np.int64) for name in table.dtype.names or ()]


def _assemble(stamp_ns: Ints, counts: Ints,
              parts: list[tuple[Ints, NDArray[np.void]]]) -> Frames:
    """Put the points of every layout at the places of their messages."""
    first = np.concatenate(([0], np.cumsum(counts)))
    columns = {name: np.empty(first[-1]) for name in ('u', 'v', 'sigma', 'magnitude')}
    columns['catalog_id'] = np.empty(first[-1], np.int64)
    for rows, points in parts:
        n = counts[rows]
        to = np.repeat(first[rows] - np.cumsum(n) + n, n) + np.arange(len(points))
        for name, column in columns.items():
            values = points[name] if name in (points.dtype.names or ()) else _WHEN_MISSING[name]
            # A signalling NaN, or a number beyond int64, is data and no reason for a warning.
            with np.errstate(invalid='ignore'):
                if name == 'catalog_id':
                    values = np.where(np.abs(values) < _LARGEST_ID, values, 0)
                column[to] = values
    return Frames(stamp_ns, first, np.column_stack((columns['u'], columns['v'])),
                  columns['sigma'], columns['magnitude'], columns['catalog_id'])
