# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `serve`: the running estimator on a page for browsers, by `starcal_ros.live.server`.

It keeps the newest of what the estimator says, and all viewers get that: the estimator has one
listener, however many they are. With --json it writes its address as a line of JSON, too.
"""

from __future__ import annotations

from functools import partial
import json
from typing import Any

from starcal_ros.live.picture import encoded
from starcal_ros.live.serving import ServerThread
from starcal_ros.nodes.base import command_line, parameters, run_loop
from starcal_ros.nodes.base.results_listener import ResultsListener

_LOOK_S = 0.25


class Serve(ResultsListener):
    """Serve what the estimator says."""

    def __init__(self, as_json: bool = False, **options: Any) -> None:
        super().__init__('serve', **options)
        given = parameters.declare(self, 'serve').serve
        of = f'{self.get_namespace().strip("/")}/estimator'.lstrip('/')
        self._server = ServerThread(of, given.host, given.port)
        self.get_logger().info(f'{self._server.address} shows {of}')
        if as_json:
            command_line.tell(json.dumps({'address': self._server.address, 'shows': of}))
        run_loop.steady_timer(self, _LOOK_S, self._publish)

    def close(self) -> None:
        """Let the viewers go."""
        self._server.close()

    def _publish(self) -> None:
        self._server.publish(encoded(self.seen))


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_loop.run(Serve, args, partial(Serve, as_json=True))
