"""The page's server: this machine alone, known host names alone, nothing lost over a broken
connection, memory that is bounded.
"""

from __future__ import annotations

import http.client
import json
import re
import socket
import time
from collections.abc import Iterator

import numpy as np
import pytest

from scenarios.watching import page as watch_page
from scenarios.watching.page import Feed, PageServer, page
from scenarios.watching.reference import CrossValidation
from sim.errors import DeclarationError

Event = tuple[str, str, str]  # id, name, data


@pytest.fixture(scope="module")
def server() -> Iterator[PageServer]:
    """A server for tests that do not stop it."""
    made = PageServer(Feed())
    made.start()
    yield made
    made.stop()


class Browser:
    """What a browser does with server-sent events, by the standard's words."""

    def __init__(self, port: int, last: str = "") -> None:
        self._connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
        self._connection.request("GET", "/events", headers={"Last-Event-ID": last} if last else {})
        self._answer = self._connection.getresponse()
        assert (self._answer.status, self._answer.getheader("Content-Type")) == (
            200,
            "text/event-stream",
        )

    def read(self, until: str = "beat") -> list[Event]:
        """Events up to one of that name; none of it where the line ends first."""
        found: list[Event] = []
        fields = {"id": "", "event": "", "data": ""}
        while not found or found[-1][1] != until:
            line = self._answer.readline().decode()
            if not line:
                break
            name, _, value = line.rstrip("\n").partition(": ")
            if name in fields:
                fields[name] = value
            elif line == "\n" and fields["event"]:
                found.append((fields["id"], fields["event"], fields["data"]))
                fields = {"id": "", "event": "", "data": ""}
        return found

    def close(self) -> None:
        self._connection.close()


def asked(port: int, hosts: list[str], path: str = "/") -> str:
    """The first line of the answer to a request with these Host headers."""
    with socket.create_connection(("127.0.0.1", port), timeout=5.0) as line:
        line.sendall(
            "".join(
                [
                    f"GET {path} HTTP/1.1\r\n",
                    *(f"Host: {host}\r\n" for host in hosts),
                    "Connection: close\r\n\r\n",
                ]
            ).encode()
        )
        return line.recv(200).decode().splitlines()[0]


def rows(first: int, count: int) -> str:
    return json.dumps({"t": [k / 40.0 for k in range(first, first + count)]})


def test_it_listens_on_this_machine_alone_and_to_its_own_names(server: PageServer) -> None:
    assert server.socket.getsockname()[0] == "127.0.0.1"
    port = server.port
    for host in (f"127.0.0.1:{port}", f"localhost:{port}", f"LOCALHOST:{port}"):
        assert asked(port, [host]).endswith("200 OK")
    names = [
        f"evil.example:{port}",
        "127.0.0.1",
        f"127.0.0.1:{port + 1}",
        f"127.0.0.1.evil.example:{port}",
        f"[::1]:{port}",
        "",
    ]
    for hosts in [[], [f"127.0.0.1:{port}", f"evil.example:{port}"], *([name] for name in names)]:
        for path in ("/", "/events"):
            assert " 421 " in asked(port, hosts, path), hosts
    assert " 404 " in asked(port, [f"127.0.0.1:{port}"], "/record.csv")


def test_the_page_fetches_nothing_from_elsewhere() -> None:
    text = page()
    assert "EventSource" in text and ":root" in text and "/* page." not in text
    assert re.findall(r"""(?:src|href)=["'](?!data:)[^"']*|https?://|@import|url\(""", text) == []


def test_what_was_missed_is_caught_up_once() -> None:
    server = PageServer(Feed())
    server.start()
    feed = server.feed
    feed.put("about", '{"name":"stream"}')
    feed.put("rows", rows(0, 4), rows=4)
    first = Browser(server.port)
    seen = first.read()
    assert [name for _, name, _ in seen] == ["anew", "about", "rows", "beat"]
    last = seen[-1][0]
    server.drop_readers()
    feed.put("rows", rows(4, 4), rows=4)
    feed.put("rows", rows(8, 4), rows=4)
    again = Browser(server.port, last)
    came = again.read()
    assert [(name, data) for _, name, data in came[:-1]] == [
        ("rows", rows(4, 4)),
        ("rows", rows(8, 4)),
    ]
    feed.put("status", "{}")
    assert [name for _, name, _ in again.read()] == ["status", "beat"]
    other = Browser(server.port, "0badcafe-1")  # of another watch on the same port
    assert next(name for _, name, _ in other.read()) == "anew"
    began = time.monotonic()
    server.stop()
    assert time.monotonic() - began < 2.0
    assert again.read("bye")[-1][1] == "bye"
    for each in (first, again, other):
        each.close()


def test_memory_is_bounded_and_the_whole_time_stays_in_sight() -> None:
    feed = Feed(rows=600, estimates=50, events=100)
    for k in range(5000):
        feed.put("rows", rows(4 * k, 4), rows=4)
        feed.put("estimates", json.dumps({"t": k}))
        feed.put("status", json.dumps({"rows": 4 * k}))
    events, kept, estimates = feed.kept
    assert events == 100 and 596 <= kept <= 600 and estimates <= 50
    whole = feed.since(3, 0.0)  # long forgotten
    assert whole.complete
    told = [json.loads(event.data)["t"] for event in whole.events if event.name == "estimates"]
    steps = np.diff(told[:-1])
    assert (
        told[0] == 0
        and told[-1] == 4999
        and len(told) <= 51
        and steps.max() == steps.min()
        and steps.max() <= 5000 / 25
    )
    times = [
        t for event in whole.events if event.name == "rows" for t in json.loads(event.data)["t"]
    ]
    np.testing.assert_allclose(np.diff(times), 1.0 / 40.0, atol=1e-9)
    assert times[-1] == 19999 / 40.0 and [event.name for event in whole.events].count("status") == 1
    assert not feed.since(whole.last, 0.0).events


def test_the_last_word_reaches_a_reader_whenever_the_feed_closes() -> None:
    feed = Feed()
    feed.put("status", "{}")
    before = feed.since(None, 0.0)
    feed.close()  # between two questions of one reader
    assert not before.over
    after = feed.since(before.last, 0.0)
    assert after.over and [event.name for event in after.events] == ["bye"]


def test_a_reader_who_is_slow_gets_all_that_is_kept() -> None:
    feed = Feed(events=10)
    feed.put("rows", rows(0, 1), rows=1)
    last = feed.since(None, 0.0).last
    for k in range(10):
        feed.put("rows", rows(k, 1), rows=1)
    assert not feed.since(last, 0.0).complete and len(feed.since(last, 0.0).events) == 10
    feed.put("status", "{}")
    assert feed.since(last, 0.0).complete


def test_a_port_that_is_taken(server: PageServer) -> None:
    with pytest.raises(DeclarationError, match=f"port {server.port} cannot be had"):
        PageServer(Feed(), server.port)
    other = PageServer(Feed())
    assert other.port != server.port
    other.server_close()


def test_events_are_strict_json() -> None:
    hanging = CrossValidation("M_q", "1/s", 1.0, np.inf, (1.0, 0.1), hanging=True)
    known = CrossValidation("delay", "s", 0.118, 0.003, (0.1, 0.001))
    told = json.loads(
        watch_page.estimates(2.0, [hanging, known], np.array([0.25, 0.75]), "refined"),
        parse_constant=pytest.fail,
    )
    assert (
        told["items"][0]["told"] == "depends on start"
        and "value" not in told["items"][0]
        and "off" not in told["items"][0]
    )
    assert told["items"][1]["off"] == pytest.approx(5.69, abs=0.01) and told["items"][1]["outside"]
    assert json.loads(watch_page.status("waiting", "", {"t": np.nan, "rows": 3}))["t"] is None
