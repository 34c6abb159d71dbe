# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Foxglove's annotations of images, for recordings of machines that do not have foxglove_msgs.

These are the fields that every release of foxglove_msgs has, in their order; what is newer stands
behind them there, and viewers do without. Pixels are counted from the corner of the first one.
"""

CORNER = 0.5
"""What raster pixels, (0, 0) the centre of the first, are less than those of annotations."""

CIRCLE, POINTS, TEXT, ANNOTATIONS = (
    f'foxglove_msgs/msg/{name}' for name in (
        'CircleAnnotation', 'PointsAnnotation', 'TextAnnotation', 'ImageAnnotations'))
POINT, COLOR = 'foxglove_msgs/msg/Point2', 'foxglove_msgs/msg/Color'
LINE_LIST = 4           # of PointsAnnotation: from each point of a pair to the other

DEFINITIONS = {
    POINT: 'float64 x\nfloat64 y',
    COLOR: 'float64 r\nfloat64 g\nfloat64 b\nfloat64 a',
    CIRCLE: 'builtin_interfaces/Time timestamp\nfoxglove_msgs/Point2 position\n'
            'float64 diameter\nfloat64 thickness\nfoxglove_msgs/Color fill_color\n'
            'foxglove_msgs/Color outline_color',
    POINTS: 'uint8 UNKNOWN=0\nuint8 POINTS=1\nuint8 LINE_LOOP=2\nuint8 LINE_STRIP=3\n'
            'uint8 LINE_LIST=4\nbuiltin_interfaces/Time timestamp\nuint8 type\n'
            'foxglove_msgs/Point2[] points\nfoxglove_msgs/Color outline_color\n'
            'foxglove_msgs/Color[] outline_colors\nfoxglove_msgs/Color fill_color\n'
            'float64 thickness',
    TEXT: 'builtin_interfaces/Time timestamp\nfoxglove_msgs/Point2 position\nstring text\n'
          'float64 font_size\nfoxglove_msgs/Color text_color\n'
          'foxglove_msgs/Color background_color',
    ANNOTATIONS: 'foxglove_msgs/CircleAnnotation[] circles\n'
                 'foxglove_msgs/PointsAnnotation[] points\n'
                 'foxglove_msgs/TextAnnotation[] texts',
}
"""Each type by its name, in the language of .msg files."""
