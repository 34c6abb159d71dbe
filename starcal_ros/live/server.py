# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The page of a calibration over HTTP, for browsers on this machine.

::

    GET /               the page; live.css, live.js
    GET /source         what it shows: {title, moments}, the stamps of a recording or null
    GET /moments/K      one moment of a recording (`picture`)
    GET /events         the newest moment of a running estimator, whenever there is one
                        (server-sent events)

All viewers get the same bytes, which are made once. A viewer that is slow misses moments and gets
the newest when it is ready: nothing is kept for it, and nobody waits for it.

Who may ask
-----------
It listens to this machine alone unless it is told otherwise. A page of somebody else in a browser
here could still ask: by a name of theirs that leads here (DNS rebinding), which the header Host
shows, or from their own page, which Origin shows. Both are refused, and other pages may neither
embed nor read what is served.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from importlib.resources import files
import ipaddress
import json
import socket
from urllib.parse import urlsplit

from aiohttp import web

from starcal_ros.config.parameter import ConfigError

HEADERS = {
    'Content-Security-Policy': "default-src 'none'; script-src 'self'; style-src 'self'; "
                               "img-src data:; connect-src 'self'; base-uri 'none'; "
                               "form-action 'none'; frame-ancestors 'none'",
    'Cross-Origin-Resource-Policy': 'same-origin', 'X-Content-Type-Options': 'nosniff',
    'Referrer-Policy': 'no-referrer', 'Cache-Control': 'no-store'}
MOST_VIEWERS = 32
"""Viewers of a running estimator at once; more are told to come later."""

_PAGES = {'/': ('live.html', 'text/html'), '/live.css': ('live.css', 'text/css'),
          '/live.js': ('live.js', 'text/javascript')}
_STALLED_S = 20.0       # without a byte taken, after which a viewer is let go
_ALIVE_S = 5.0          # from one sign of life to the next where nothing is new
_Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class Server:
    """Serves one calibration.

    Parameters
    ----------
    title : str
        What the page is of.
    host, port
        Where to listen; port 0 is any that is free.
    moments : sequence of (str, bytes), optional
        Stamps and pictures of a recording; without them it is live, see `publish`.

    Attributes
    ----------
    viewers : int
        How many look on at what is live.
    """

    def __init__(self, title: str, host: str, port: int,
                 moments: Sequence[tuple[str, bytes]] | None = None) -> None:
        self._source = json.dumps({'title': title, 'moments': None if moments is None else [
            stamp for stamp, _ in moments]}).encode()
        self._moments = [picture for _, picture in moments or ()]
        self._host, self._port = host, port
        self._newest, self._version, self.viewers = b'', 0, 0
        self._changed = asyncio.Event()         # another one for each moment
        self._runner: web.AppRunner | None = None
        self._closed = False

    async def start(self) -> str:
        """Begin to listen, and return the address of the page.

        Raises
        ------
        ConfigError
            Where it can not listen there.
        """
        app = web.Application(middlewares=[self._guarded])
        app.add_routes([*(web.get(path, self._page) for path in _PAGES),
                        web.get('/source', self._get_source),
                        web.get(r'/moments/{k:\d{1,6}}', self._get_moment),
                        web.get('/events', self._events)])
        self._runner = web.AppRunner(app, access_log=None, shutdown_timeout=0.5)
        await self._runner.setup()
        try:
            await web.TCPSite(self._runner, self._host, self._port).start()
        except (OSError, OverflowError, UnicodeError) as error:
            await self._runner.cleanup()
            raise ConfigError(f'serve: cannot listen on {self._host}, port {self._port}: '
                              f'{getattr(error, "strerror", None) or error}') from None
        self._port = self._runner.addresses[0][1]
        host = f'[{self._host}]' if ':' in self._host else self._host
        return f'http://{host}:{self._port}/'

    def publish(self, picture: bytes) -> None:
        """Show a moment to all who look on, in place of the one before; in the loop's thread."""
        self._newest, self._version = picture, self._version + 1
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    async def close(self) -> None:
        """Let all viewers go."""
        self._closed = True
        self._changed.set()
        if self._runner is not None:
            await self._runner.cleanup()

    # Requests

    @web.middleware
    async def _guarded(self, request: web.Request, handler: _Handler) -> web.StreamResponse:
        refusal = self._refusal(request)
        if refusal:
            return web.Response(status=403, text=refusal + '\n', headers=HEADERS)
        try:
            return await handler(request)
        except web.HTTPException as error:
            error.headers.update(HEADERS)
            raise

    def _refusal(self, request: web.Request) -> str:
        """Say why a request is not answered, '' where it is."""
        host, origin = request.headers.get('Host', ''), request.headers.get('Origin')
        name = urlsplit(f'//{host}').hostname or ''
        if not _is_own(name, self._host):
            return f'the header Host names {name or "nothing"}, which is not this server'
        if origin is not None and urlsplit(origin).netloc != host:
            return 'the header Origin names the page of another server'
        return ''

    async def _page(self, request: web.Request) -> web.Response:
        name, kind = _PAGES[request.path]
        text = (files('starcal_ros') / 'data' / name).read_text('utf-8')
        return web.Response(text=text, content_type=kind, headers=HEADERS)

    async def _get_source(self, _: web.Request) -> web.Response:
        return _json(self._source)

    async def _get_moment(self, request: web.Request) -> web.Response:
        k = int(request.match_info['k'])
        if k >= len(self._moments):
            raise web.HTTPNotFound(text=f'moment {k}: there are {len(self._moments)}\n')
        return _json(self._moments[k])

    async def _events(self, request: web.Request) -> web.StreamResponse:
        if self.viewers >= MOST_VIEWERS:
            raise web.HTTPServiceUnavailable(text=f'{MOST_VIEWERS} viewers look on already\n')
        response = web.StreamResponse(headers={**HEADERS, 'Content-Type': 'text/event-stream'})
        self.viewers += 1
        try:
            await response.prepare(request)
            seen = 0
            while not self._closed:
                event, seen = await self._next(seen)
                await asyncio.wait_for(response.write(event), _STALLED_S)
        except (ConnectionError, asyncio.TimeoutError):
            if request.transport is not None:
                request.transport.abort()       # what is left in its buffer is not wanted
        finally:
            self.viewers -= 1
        return response

    async def _next(self, seen: int) -> tuple[bytes, int]:
        """Return the newest moment as an event, as soon as one is newer, or a sign of life."""
        if self._version == seen:
            try:
                await asyncio.wait_for(self._changed.wait(), _ALIVE_S)
            except asyncio.TimeoutError:
                return b': alive\n\n', seen
        return b'data: ' + self._newest + b'\n\n', self._version


def _json(data: bytes) -> web.Response:
    return web.Response(body=data, content_type='application/json', headers=HEADERS)


def _is_own(name: str, host: str) -> bool:
    """Tell whether a name or address in a request is this server's own, listening on a host.

    Who listens to this machine alone is called by the names of this machine. Who listens to others
    is called by an address as well, which nobody else can make lead here.
    """
    if name in ('localhost', host):
        return True
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        return not _is_loopback(host) and name == socket.gethostname().lower()
    return address.is_loopback or not _is_loopback(host)


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == 'localhost'
