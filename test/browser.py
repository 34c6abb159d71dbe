# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Headless Chromium, spoken to by its DevTools protocol, for pages that change while one looks."""

import asyncio
import base64
from contextlib import contextmanager
import itertools
import json
import shutil
import subprocess
import time

import aiohttp
import pytest

BROWSER = shutil.which('chromium')
PATIENCE_S = 60.0


class Tab:
    """One page of the browser.

    Attributes
    ----------
    complaints : list of str
        What was said on its console as a warning or an error, or was not caught.
    """

    def __init__(self, loop, socket):
        self._loop, self._socket, self._ids = loop, socket, itertools.count(1)
        self.complaints = []
        for domain in ('Page', 'Runtime', 'Log'):
            self._do(f'{domain}.enable')

    def look(self, width, height, dark=False):
        """Set the size of the page, which may be that of a telephone, and the colours wanted."""
        self._do('Emulation.setDeviceMetricsOverride', width=width, height=height,
                 deviceScaleFactor=1, mobile=width < 500)
        self._do('Emulation.setEmulatedMedia', features=[
            {'name': 'prefers-color-scheme', 'value': 'dark' if dark else 'light'}])

    def open(self, address):
        """Go to a page, and wait for all that it loads at first."""
        self._do('Page.navigate', url=address)
        self.until(f'location.href == {json.dumps(address)} && document.readyState == "complete"')

    def tell(self, expression):
        """Return what an expression is on the page."""
        answer = self._do('Runtime.evaluate', expression=expression, returnByValue=True,
                          awaitPromise=True)
        assert 'exceptionDetails' not in answer, answer['exceptionDetails']
        return answer['result'].get('value')

    def until(self, expression):
        """Wait until an expression is true on the page, and return what it is."""
        deadline = time.monotonic() + PATIENCE_S
        while not (value := self.tell(expression)):
            assert time.monotonic() < deadline, (expression, self.tell('document.body.innerText'))
            time.sleep(0.1)
        return value

    def picture(self, path):
        """Write the whole page as PNG."""
        data = self._do('Page.captureScreenshot', captureBeyondViewport=True)['data']
        path.write_bytes(base64.b64decode(data))

    def _do(self, method, **parameters):
        return self._loop.run_until_complete(asyncio.wait_for(
            self._ask(method, parameters), PATIENCE_S))

    async def _ask(self, method, parameters):
        number = next(self._ids)
        await self._socket.send_json({'id': number, 'method': method, 'params': parameters})
        while True:
            told = await self._socket.receive_json()
            if told.get('id') == number:
                assert 'error' not in told, told
                return told['result']
            self._note(told)

    def _note(self, told):
        method, what = told.get('method'), told.get('params', {})
        if method == 'Runtime.exceptionThrown':
            self.complaints.append(str(what['exceptionDetails']))
        elif method == 'Log.entryAdded' and what['entry']['level'] in ('warning', 'error'):
            self.complaints.append(what['entry']['text'])
        elif method == 'Runtime.consoleAPICalled' and what['type'] in ('warning', 'error'):
            self.complaints.append(str(what['args']))


@contextmanager
def browsing(profile):
    """Yield a `Tab` of a browser with its profile in a folder; skip where there is none."""
    if BROWSER is None:
        pytest.skip('chromium is not installed')
    process = subprocess.Popen([
        BROWSER, '--headless', '--no-sandbox', '--disable-gpu', '--disable-quic',
        '--no-first-run', '--disable-background-networking', '--disable-component-update',
        '--disable-sync', f'--user-data-dir={profile}', '--remote-debugging-port=0',
        'about:blank'], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    loop = asyncio.new_event_loop()
    try:
        session = loop.run_until_complete(_session())
        socket = loop.run_until_complete(_connected(session, profile))
        yield Tab(loop, socket)
    finally:
        process.kill()
        process.wait()
        loop.run_until_complete(session.close())
        loop.close()


async def _session():
    return aiohttp.ClientSession()


async def _connected(session, profile):
    """Return a connection to the page that the browser has opened."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        await asyncio.sleep(0.1)
        try:
            port = (profile / 'DevToolsActivePort').read_text().split()[0]
            async with session.get(f'http://127.0.0.1:{port}/json/list') as answer:
                page = next(each for each in await answer.json() if each['type'] == 'page')
        except (OSError, IndexError, StopIteration):
            continue
        return await session.ws_connect(page['webSocketDebuggerUrl'], max_msg_size=0)
    raise AssertionError('the browser has not answered')
