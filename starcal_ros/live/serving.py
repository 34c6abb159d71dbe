# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The server at work: until a signal ends it, or in a thread beside what it shows."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Sequence
import signal
import threading
from typing import TYPE_CHECKING, Any

from starcal_ros.config.parameter import ConfigError

if TYPE_CHECKING:
    from starcal_ros.live.server import Server


def serve(title: str, host: str, port: int, moments: Sequence[tuple[str, bytes]],
          on_start: Callable[[str], None]) -> None:
    """Serve the moments of a recording until SIGINT or SIGTERM.

    Parameters
    ----------
    title, host, port, moments
        As for `server.Server`.
    on_start : callable
        Called with the address of the page.

    Raises
    ------
    ConfigError
        Where it can not listen, or aiohttp is not installed.
    """
    server = _server(title, host, port, moments)

    async def until_signal() -> None:
        stop = asyncio.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        on_start(await server.start())
        try:
            await stop.wait()
        finally:
            await server.close()

    asyncio.run(until_signal())


class ServerThread:
    """Serves what a running estimator says, in a thread of its own.

    Parameters
    ----------
    title, host, port
        As for `server.Server`.

    Attributes
    ----------
    address : str
        Of the page.

    Raises
    ------
    ConfigError
        Where it can not listen, or aiohttp is not installed.
    """

    def __init__(self, title: str, host: str, port: int) -> None:
        self._server = _server(title, host, port)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name='server', daemon=True)
        self._thread.start()
        self._published = b''
        try:
            self.address: str = self._wait(self._server.start())
        except ConfigError:
            self._end()
            raise

    def publish(self, picture: bytes) -> None:
        """Show a moment, where it is another than the one before; whoever calls does not wait."""
        if picture != self._published:
            self._published = picture
            self._loop.call_soon_threadsafe(self._server.publish, picture)

    def close(self) -> None:
        """Let all viewers go."""
        self._wait(self._server.close())
        self._end()

    def _wait(self, of: Coroutine[Any, Any, Any]) -> Any:
        return asyncio.run_coroutine_threadsafe(of, self._loop).result()

    def _end(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


def _server(*given: Any) -> Server:
    try:
        from starcal_ros.live.server import Server
    except ImportError:
        raise ConfigError("serve: needs aiohttp: pip install 'starcal_ros[serve]'") from None
    return Server(*given)
