# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `watch`: the running estimator in the terminal, as `starcal_ros.live.terminal` draws it.

On a terminal it redraws twice a second; where it writes into a file or a pipe, it writes the last
view, when it ends. With --json it writes what is new twice a second, a line of JSON each time, as
`starcal_ros.live.picture` describes it.
"""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.live import Live

from starcal_ros.live.picture import encoded
from starcal_ros.live.terminal import render
from starcal_ros.nodes.base import command_line, run_loop
from starcal_ros.nodes.base.results_listener import ResultsListener

_DRAW_S = 0.5
_PIPE_COLUMNS = 100


class Watch(ResultsListener):
    """Draw what the estimator says."""

    def __init__(self, **options: Any) -> None:
        super().__init__('watch', **options)
        self._console = Console()
        if not self._console.is_terminal:
            self._console = Console(width=_PIPE_COLUMNS)
        self._live = Live(console=self._console, screen=self._console.is_terminal,
                          auto_refresh=False)
        if self._console.is_terminal:
            self._live.start()
            run_loop.steady_timer(self, _DRAW_S, self._draw)

    def close(self) -> None:
        """Leave the last view on the terminal."""
        self._live.stop()
        self._console.print(render(self.seen))

    def _draw(self) -> None:
        self._live.update(render(self.seen), refresh=True)


class WatchAsJson(ResultsListener):
    """Write what the estimator says, for programs."""

    def __init__(self, **options: Any) -> None:
        super().__init__('watch', **options)
        self._written = b''
        run_loop.steady_timer(self, _DRAW_S, self._write)

    def close(self) -> None:
        """Write what is new at the end."""
        self._write()

    def _write(self) -> None:
        if (line := encoded(self.seen)) == self._written:
            return
        self._written = line
        if not command_line.tell(line.decode()):
            run_loop.request_stop()


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_loop.run(Watch, args, WatchAsJson)
