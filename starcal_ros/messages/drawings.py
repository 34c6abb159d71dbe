# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Drawings as messages, in the classes of whoever asks: markers, and annotations of images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.messages import foxglove, topics
from starcal_ros.messages.contents import Contents

Rgb = tuple[float, float, float]
LINE_STRIP, LINE_LIST, SPHERE_LIST, TEXT = 4, 5, 7, 9       # of visualization_msgs/Marker
_NO_ROTATION = np.eye(3)


class Drawings(Contents):
    """Makes messages that are drawn."""

    def marker_array(self, markers: Sequence[Any]) -> Any:
        """Return `starcal/display/markers`."""
        return self._new(topics.MARKERS.type_name, markers=list(markers))

    def marker(self, stamp_ns: int, frame_id: str, name: str, kind: int, points: Array,
               colors: Sequence[Rgb], size: float, text: str = '') -> Any:
        """Return visualization_msgs/Marker, which takes the place of the one before of its name.

        Parameters
        ----------
        stamp_ns, frame_id
            Of the header.
        name : str
            The namespace of the marker, which viewers list.
        kind : int
            LINE_STRIP, LINE_LIST, SPHERE_LIST or TEXT.
        points : (n, 3) array
            In the frame [m]; of a text its place.
        colors : sequence of n colours
        size : float
            Width of lines, diameter of spheres, height of a text [m].
        text : str
        """
        is_text = kind == TEXT
        thick = 0.0 if kind in (LINE_STRIP, LINE_LIST) else size
        return self._new(
            'visualization_msgs/msg/Marker', header=self._header(stamp_ns, frame_id), ns=name,
            id=0, type=kind, action=0, frame_locked=False,
            pose=self._new('geometry_msgs/msg/Pose', position=self._point(
                points[0] if is_text else np.zeros(3)),
                orientation=self._quaternion(_NO_ROTATION)),
            scale=self._vector(np.array([size, thick, thick])),
            color=self._rgba(colors[0] if colors else (0.0, 0.0, 0.0)),
            lifetime=self._new('builtin_interfaces/msg/Duration', sec=0, nanosec=0),
            points=[] if is_text else [self._point(point) for point in points],
            colors=[] if is_text else [self._rgba(color) for color in colors],
            texture_resource='', uv_coordinates=[], text=text, mesh_resource='',
            mesh_use_embedded_materials=False,
            texture=self._new('sensor_msgs/msg/CompressedImage', header=self._header(0, ''),
                              format='', data=self._types.sequence(np.empty(0, np.uint8))),
            mesh_file=self._new('visualization_msgs/msg/MeshFile', filename='',
                                data=self._types.sequence(np.empty(0, np.uint8))))

    def image_annotations(self, circles: Sequence[Any], points: Sequence[Any],
                          texts: Sequence[Any]) -> Any:
        """Return `starcal/display/annotations`."""
        return self._new(topics.ANNOTATIONS.type_name, circles=list(circles), points=list(points),
                         texts=list(texts))

    def circle(self, stamp_ns: int, uv: Array, diameter_px: float, stroke_px: float, color: Rgb
               ) -> Any:
        """Return a circle about raster pixel uv (2,)."""
        return self._new(
            foxglove.CIRCLE, timestamp=self._stamp(stamp_ns), position=self._pixel(uv),
            diameter=diameter_px, thickness=stroke_px, fill_color=self._clear(),
            outline_color=self._color(color))

    def line_list(self, stamp_ns: int, uv: Array, stroke_px: float, colors: Sequence[Rgb]) -> Any:
        """Return lines between raster pixels uv (2n, 2), two by two, each in its colour."""
        return self._new(
            foxglove.POINTS, timestamp=self._stamp(stamp_ns), type=foxglove.LINE_LIST,
            points=[self._pixel(each) for each in uv], outline_color=self._clear(),
            outline_colors=[self._color(color) for color in colors], fill_color=self._clear(),
            thickness=stroke_px)

    def text(self, stamp_ns: int, uv: Array, text: str, height_px: float, color: Rgb) -> Any:
        """Return a text whose lower left corner is at raster pixel uv (2,)."""
        return self._new(
            foxglove.TEXT, timestamp=self._stamp(stamp_ns), position=self._pixel(uv), text=text,
            font_size=height_px, text_color=self._color(color), background_color=self._clear())

    def _pixel(self, uv: Array) -> Any:
        u, v = (uv + foxglove.CORNER).tolist()
        return self._new(foxglove.POINT, x=u, y=v)

    def _color(self, color: Rgb, opaque: float = 1.0) -> Any:
        return self._new(foxglove.COLOR, **dict(zip('rgba', (*color, opaque))))

    def _clear(self) -> Any:
        return self._color((0.0, 0.0, 0.0), 0.0)

    def _rgba(self, color: Rgb) -> Any:
        return self._new('std_msgs/msg/ColorRGBA', **dict(zip('rgba', (*color, 1.0))))

    def _point(self, values: Array) -> Any:
        return self._new('geometry_msgs/msg/Point', **dict(zip('xyz', values.tolist())))
