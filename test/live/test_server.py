# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The server of the page, by HTTP: what it gives to whom, and that nobody waits for a viewer."""

import asyncio
from contextlib import asynccontextmanager
from importlib.resources import files
import json
import re
import socket
import sys
import time

import pytest

aiohttp = pytest.importorskip('aiohttp')

from starcal_ros.config.parameter import ConfigError  # noqa: E402
from starcal_ros.live import server as module  # noqa: E402
from starcal_ros.live.server import HEADERS, MOST_VIEWERS, Server  # noqa: E402
from starcal_ros.live.serving import ServerThread  # noqa: E402

LOOPBACK = '127.0.0.1'
MOMENTS = [('2026-07-02T12:00:00', b'{"a":1}'), ('2026-07-02T12:00:01', b'{"a":2}')]
PATIENCE_S = 20.0


@asynccontextmanager
async def serving(moments=None, host=LOOPBACK):
    """Serve, and yield the server, its address and a client."""
    server = Server('<b>run</b>', host, 0, moments)
    address = await server.start()
    try:
        async with aiohttp.ClientSession() as client:
            yield server, address.replace('0.0.0.0', LOOPBACK), client
    finally:
        await server.close()


def ask(path, moments=MOMENTS, host=LOOPBACK, method='GET', **headers):
    """Return status, headers and body of an answer."""
    async def asked():
        async with serving(moments, host) as (_, address, client):
            port = address.rsplit(':', 1)[1].strip('/')
            sent = {name: value.replace('PORT', port) for name, value in headers.items()}
            async with client.request(method, address + path, headers=sent) as answer:
                return answer.status, answer.headers, await answer.text()
    return asyncio.run(asked())


async def event(answer):
    """Return the next moment of a stream of events."""
    while True:
        line = await asyncio.wait_for(answer.content.readuntil(b'\n\n'), PATIENCE_S)
        if line.startswith(b'data: '):
            return json.loads(line[6:])


# What is served


@pytest.mark.parametrize('path, kind', [
    ('', 'text/html'), ('live.css', 'text/css'), ('live.js', 'text/javascript'),
    ('source', 'application/json'), ('moments/1', 'application/json')])
def test_the_page_and_its_parts_are_served_with_their_types_and_guards(path, kind):
    status, headers, text = ask(path)
    assert status == 200 and headers['Content-Type'].split(';')[0] == kind and text
    assert {name: headers[name] for name in HEADERS} == HEADERS
    assert "default-src 'none'" in headers['Content-Security-Policy']


def test_moments_of_a_recording_are_given_one_by_one():
    assert json.loads(ask('source')[2]) == {
        'title': '<b>run</b>', 'moments': [stamp for stamp, _ in MOMENTS]}
    assert [ask(f'moments/{k}')[2] for k in (0, 1)] == ['{"a":1}', '{"a":2}']
    assert json.loads(ask('source', None)[2])['moments'] is None


@pytest.mark.parametrize('path, status', [
    ('moments/2', 404), ('moments/-1', 404), ('moments/x', 404), ('moments/99999999999999', 404),
    ('../setup.py', 404), ('live.html', 404), ('data/live.html', 404)])
def test_what_is_not_there_is_not_found(path, status):
    found, headers, _ = ask(path)
    assert found == status and headers['Content-Security-Policy']


@pytest.mark.parametrize('method', ['POST', 'PUT', 'DELETE', 'OPTIONS'])
def test_nothing_can_be_changed(method):
    assert ask('source', method=method)[0] == 405


def test_the_page_loads_nothing_from_elsewhere_and_sets_no_markup():
    pages = [(files('starcal_ros') / 'data' / f'live.{kind}').read_text('utf-8')
             for kind in ('html', 'css', 'js')]
    # the only address is the name of the language of drawings
    assert re.findall(r'\bhttps?://[^\'"\s]*', ''.join(pages)) == ['http://www.w3.org/2000/svg']
    assert not re.search(r'innerHTML|outerHTML|insertAdjacent|document\.write|eval\(', pages[2])
    # the policy allows no code and no style that stands in the page
    assert not re.search(r'<script>|<style|\sstyle=|\son\w+=', pages[0])


# Who may ask


@pytest.mark.parametrize('host', ['127.0.0.1:PORT', 'localhost:PORT', '[::1]:PORT', 'LOCALHOST'])
def test_the_names_of_this_machine_are_answered(host):
    assert ask('source', Host=host)[0] == 200


@pytest.mark.parametrize('host', ['evil.example:PORT', 'evil.example', '127.0.0.1.evil.example',
                                  'localhost.evil.example:PORT', '192.0.2.1:PORT', ''])
def test_a_name_that_was_led_here_is_refused(host):
    status, headers, text = ask('source', Host=host)
    assert status == 403 and 'the header Host names' in text and 'run' not in text
    assert headers['Content-Security-Policy']


@pytest.mark.parametrize('origin, status', [
    ('http://127.0.0.1:PORT', 200), ('http://evil.example', 403), ('null', 403),
    ('http://127.0.0.1:1', 403), ('http://localhost:PORT', 403)])
def test_the_page_of_another_is_refused(origin, status):
    assert ask('source', Origin=origin)[0] == status


@pytest.mark.parametrize('host, status', [
    ('192.0.2.1:PORT', 200), ('127.0.0.1', 200), (socket.gethostname(), 200),
    ('evil.example:PORT', 403)])
def test_open_to_the_network_it_is_called_by_addresses_and_its_own_name(host, status):
    assert ask('source', host='0.0.0.0', Host=host)[0] == status


# Those who look on


def test_every_viewer_gets_the_newest_moment_and_those_that_follow():
    async def look():
        async with serving() as (server, address, client):
            server.publish(b'{"n":0}')
            server.publish(b'{"n":1}')
            viewers = [await client.get(address + 'events') for _ in range(5)]
            assert {viewer.headers['Content-Type'] for viewer in viewers} == {'text/event-stream'}
            first = [await event(viewer) for viewer in viewers]
            server.publish(b'{"n":2}')
            return first, [await event(viewer) for viewer in viewers]
    assert asyncio.run(look()) == ([{'n': 1}] * 5, [{'n': 2}] * 5)


async def stalled(address):
    """Return a connection that asks for the events and takes nothing."""
    host, port = address.split('/')[2].split(':')
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.connect((host, int(port)))
    connection.sendall(f'GET /events HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n'.encode())
    return connection


def test_a_viewer_that_takes_nothing_holds_up_nobody_and_gets_no_backlog():
    """A moment has 100 kB: what is kept for the viewer can be but its buffers."""
    count, size = 300, 100_000

    async def look():
        async with serving() as (server, address, client):
            slow = await stalled(address)
            quick = await client.get(address + 'events', read_bufsize=2 * size)
            seen = []

            async def watch():
                while seen[-1:] != [count - 1]:
                    seen.append((await event(quick))['n'])
            watching = asyncio.create_task(watch())
            for n in range(count):
                server.publish(json.dumps({'n': n, 'x': 'x' * size}).encode())
                await asyncio.sleep(0.002)
            await asyncio.wait_for(watching, PATIENCE_S)    # the slow one has taken nothing yet
            slow.settimeout(PATIENCE_S)
            got, last = b'', json.dumps({'n': count - 1})[:-1].encode()
            while last not in got:
                got += await asyncio.get_running_loop().run_in_executor(None, slow.recv, 1 << 20)
            slow.close()
            return seen, [int(n) for n in re.findall(rb'data: {"n": (\d+)', got)]

    seen, late = asyncio.run(look())
    assert seen == sorted(set(seen)) and len(seen) > count / 10
    assert late == sorted(late) and late[-1] == count - 1
    assert len(late) < count / 4        # of 30 MB what the buffers hold, and the newest


def test_a_viewer_that_takes_nothing_for_long_is_let_go(monkeypatch):
    monkeypatch.setattr(module, '_STALLED_S', 0.3)

    async def look():
        async with serving() as (server, address, _):
            slow = await stalled(address)
            deadline = time.monotonic() + PATIENCE_S
            while server.viewers == 0 and time.monotonic() < deadline:
                await asyncio.sleep(0.01)
            while server.viewers and time.monotonic() < deadline:
                server.publish(b'{"x":"%b"}' % (b'x' * 1_000_000))
                await asyncio.sleep(0.02)
            slow.close()
            return server.viewers
    assert asyncio.run(look()) == 0


def test_a_viewer_that_leaves_is_forgotten_and_one_too_many_is_refused(monkeypatch):
    monkeypatch.setattr(module, '_ALIVE_S', 0.1)

    async def look():
        async with serving() as (server, address, _):
            async with aiohttp.ClientSession(
                    connector=aiohttp.TCPConnector(limit=0)) as client:
                viewers = [await client.get(address + 'events') for _ in range(MOST_VIEWERS)]
                async with client.get(address + 'events') as answer:
                    assert answer.status == 503 and 'look on already' in await answer.text()
                assert server.viewers == MOST_VIEWERS
                for viewer in viewers:
                    viewer.close()
                deadline = time.monotonic() + PATIENCE_S
                while server.viewers and time.monotonic() < deadline:
                    await asyncio.sleep(0.05)
                return server.viewers
    assert asyncio.run(look()) == 0


def test_where_nothing_is_new_there_is_a_sign_of_life(monkeypatch):
    monkeypatch.setattr(module, '_ALIVE_S', 0.05)

    async def look():
        async with serving() as (_, address, client):
            answer = await client.get(address + 'events')
            return [await asyncio.wait_for(answer.content.readuntil(b'\n\n'), PATIENCE_S)
                    for _ in range(2)]
    assert asyncio.run(look()) == [b': alive\n\n'] * 2


# Where it listens


def test_a_port_that_is_taken_is_said():
    with socket.create_server((LOOPBACK, 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=f'cannot listen on {LOOPBACK}, port {port}: '):
            ServerThread('run', LOOPBACK, port)


def test_an_address_that_is_not_of_this_machine_is_said():
    with pytest.raises(ConfigError, match='cannot listen on 192.0.2.1, port 0: '):
        ServerThread('run', '192.0.2.1', 0)


def test_the_thread_serves_what_is_published_and_ends():
    thread = ServerThread('run', LOOPBACK, 0)

    async def look():
        async with aiohttp.ClientSession() as client:
            answer = await client.get(thread.address + 'events')
            found = []
            for picture in (b'{"n":1}', b'{"n":1}', b'{"n":2}'):
                thread.publish(picture)
                if picture not in found:
                    found.append(picture)
                    assert await event(answer) == json.loads(picture)
    asyncio.run(look())
    thread.close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((LOOPBACK, int(thread.address.rsplit(':', 1)[1].strip('/'))))


def test_without_aiohttp_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, 'aiohttp', None)
    monkeypatch.delitem(sys.modules, 'starcal_ros.live.server')
    with pytest.raises(ConfigError, match=r"needs aiohttp: pip install 'starcal_ros\[serve\]'"):
        ServerThread('run', LOOPBACK, 0)
