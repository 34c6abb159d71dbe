# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `estimator`: gyro readings and star centroids in, calibration and attitude out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import sys
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Imu, PointCloud2
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from starcal_ros import __version__, cdr, cdr_cloud, result
from starcal_ros.cdr import Messages, RecordError
from starcal_ros.nodes import diagnostics, messages, parameters, runtime
from starcal_ros.nodes.flow import FlowPublisher, MatchedSubscription, drain
from starcal_ros.stream import FrameResult, Stream
from starcal_ros.track import Track

try:
    from tf2_msgs.msg import TFMessage
except ImportError:             # not among PyPI's packages of ROS 2; every distribution has it
    TFMessage = None

T = TypeVar('T')

_DIAGNOSTICS_S = 1.0
_PATIENCE_S = 10.0      # with a subscriber that hangs
_DRAIN_S = 6.0          # for the last results; acknowledgements may take 3 s


class Estimator(Node):
    """Feed a `Stream` from two topics and publish what it gives."""

    def __init__(self) -> None:
        super().__init__('estimator')
        self._scenario = parameters.declare(
            self, 'camera', 'mounting', 'gyro', 'star_tracker', 'observer', 'estimator')
        self._stream = Stream(self._scenario)
        self._enabled = True
        self._outputs: list[FlowPublisher] = []
        self._imu = self._output(Imu, 'starcal/imu', latched=False)
        self._state = self._output(Float64MultiArray, 'starcal/state')
        self._camera = self._output(CameraInfo, 'starcal/camera_info')
        self._bias = self._output(TwistWithCovarianceStamped, 'starcal/gyro_bias')
        self._mounting = self._output(PoseWithCovarianceStamped, 'starcal/mounting')
        self._residuals = self._output(PointCloud2, 'starcal/residuals')
        self._transform = TFMessage and self._output(TFMessage, '/tf_static')
        self._diagnostics = self._output(DiagnosticArray, 'diagnostics', latched=False)
        self._inputs = (
            MatchedSubscription(self, Imu, 'imu/data_raw', self._on_gyro, raw=True),
            MatchedSubscription(self, PointCloud2, 'star_tracker/centroids', self._on_frames,
                                raw=True))
        self.create_timer(_DIAGNOSTICS_S, self._publish_diagnostics)
        self.create_service(Trigger, '~/save_calibration', self._save)
        self.create_service(Trigger, '~/reset', self._reset)
        self.create_service(SetBool, '~/set_enabled', self._set_enabled)

    def close(self) -> None:
        """Use up what has arrived, say where the calibration stands and deliver it."""
        for subscription in self._inputs:
            subscription.take_all()
        self._publish_diagnostics()
        drain(self._outputs, _DRAIN_S)

    def _output(self, kind: type, topic: str, latched: bool = True) -> FlowPublisher:
        publisher = FlowPublisher(self, kind, topic, latched=latched, patience_s=_PATIENCE_S)
        self._outputs.append(publisher)
        return publisher

    def _on_gyro(self, batch: list[bytes]) -> None:
        if self._enabled:
            for part in self._decoded(batch, cdr.decode_imu):
                self._stream.add_gyro(part)
            self._advance()

    def _on_frames(self, batch: list[bytes]) -> None:
        if self._enabled:
            for part in self._decoded(batch, cdr_cloud.decode_centroids):
                self._stream.add_frames(part)
            self._advance()

    def _decoded(self, batch: list[bytes], decode: Callable[[Messages], T]) -> Iterator[T]:
        """Yield messages as arrays, all at once, or singly around one that is no message."""
        try:
            yield decode(Messages.join(batch))
        except RecordError as error:
            if len(batch) == 1:
                self._stream.counts.dropped_messages += 1
                self.get_logger().error(f'message dropped: {error}')
            else:
                for message in batch:
                    yield from self._decoded([message], decode)

    def _advance(self) -> None:
        """Publish what the stream gives by now."""
        for frame in self._stream.process(tracked=True):
            self._publish_track(frame.track)
            self._publish(frame)
        self._publish_track(self._stream.track())
        for text in self._stream.take_notices():
            self.get_logger().warning(text)

    def _publish_track(self, track: Track) -> None:
        for message in messages.imus(track):
            self._imu.publish(message)

    def _publish(self, frame: FrameResult) -> None:
        stamp_ns, belief = frame.stamp_ns, frame.belief
        covariance = belief.covariance
        self._state.publish(messages.state(stamp_ns, belief))
        self._camera.publish(messages.camera_info(
            stamp_ns, belief.estimate.intrinsics, self._stream.filter.detector))
        self._bias.publish(messages.gyro_bias(stamp_ns, belief, covariance))
        self._mounting.publish(messages.mounting(stamp_ns, belief, covariance))
        if self._transform:
            self._transform.publish(TFMessage(
                transforms=[messages.mounting_transform(stamp_ns, belief)]))
        self._residuals.publish(messages.residuals(frame))

    def _publish_diagnostics(self) -> None:
        now = self.get_clock().now().to_msg()
        self._diagnostics.publish(diagnostics.diagnostics(self._stream, now, self._enabled))

    def _save(self, _: Any, response: Any) -> Any:
        path = self._scenario.estimator.calibration_file
        try:
            outcome = result.result(self._stream, {
                'version': __version__, 'config_sha256': self._scenario.sha256})
            result.write_json(path, outcome)
        except result.CalibrationError as error:
            response.success, response.message = False, str(error)
        else:
            response.success, response.message = True, f'written to {path}'
        return response

    def _reset(self, _: Any, response: Any) -> Any:
        self._stream = Stream(self._scenario)
        response.success, response.message = True, 'started again from the nominal values'
        return response

    def _set_enabled(self, request: Any, response: Any) -> Any:
        self._enabled = request.data
        response.success = True
        response.message = 'estimating' if request.data else 'messages are ignored'
        return response


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return runtime.run(Estimator, args)


if __name__ == '__main__':
    sys.exit(main())
