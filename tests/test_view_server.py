"""The viewer's server: this machine alone reaches it, and it ends with the process that started it, however that ends."""

from __future__ import annotations

import contextlib
import http.client
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from rx90b_flex.view.meshcat import View

STARTS = """
import signal, sys, time
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which a run under nohup hands down as ignored
from rx90b_flex.view.meshcat import View
window = View("empty", (), ()).serve().window
print(window.server_proc.pid, window.web_url, flush=True)
time.sleep(600)
"""


@pytest.fixture(scope="module")
def server() -> Iterator[tuple[int, int]]:
    """Process and port of a server."""
    window = View("empty", (), ()).serve().window
    yield window.server_proc.pid, int(window.web_url.split(":")[2].split("/")[0])
    window.server_proc.terminate()
    window.server_proc.wait()


def answer(port: int, **headers: str) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    connection.request("GET", headers.pop("path", "/static/"), headers=headers)
    return connection.getresponse().status


def listening(pid: int) -> set[str]:
    """Addresses on which a process listens, as the kernel lists them."""
    inodes = set()
    for entry in os.scandir(f"/proc/{pid}/fd"):
        with contextlib.suppress(FileNotFoundError):  # what the server closes in between
            inodes.add(os.readlink(entry.path).removeprefix("socket:[").rstrip("]"))
    found = set()
    for table, loopback in (("tcp", "0100007F"), ("tcp6", "0" * 24 + "01000000")):
        with open(f"/proc/{pid}/net/{table}") as lines:
            rows = [line.split() for line in lines][1:]
        for row in rows:
            if row[3] == "0A" and row[9] in inodes:
                address = row[1].split(":")[0]
                found.add("loopback" if address == loopback else address)
    return found


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="the kernel's table of sockets is read")
def test_it_listens_on_the_loopback_alone(server: tuple[int, int]) -> None:
    assert listening(server[0]) == {"loopback"}


def test_an_address_of_this_machine_in_the_network_does_not_reach_it(server: tuple[int, int]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # nothing is sent: only which address would be used
        except OSError:
            pytest.skip("this machine is in no network")
        own = probe.getsockname()[0]
    with pytest.raises(OSError), socket.create_connection((own, server[1]), timeout=10):
        pass


def test_pages_of_other_hosts_are_refused_and_its_own_are_not(server: tuple[int, int]) -> None:
    port = server[1]
    assert answer(port) == 200
    assert answer(port, Host=f"localhost:{port}") == 200
    assert answer(port, Host="elsewhere.example") == 403  # a name that was made to point here
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13", "path": "/"}
    key = {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}
    assert answer(port, **upgrade, **key, Origin=f"http://127.0.0.1:{port}") == 101
    assert answer(port, **upgrade, **key, Origin="http://elsewhere.example") == 403


def alive(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize(
    "how",
    [signal.SIGKILL, *(pytest.param(s, marks=pytest.mark.slow) for s in (signal.SIGTERM, signal.SIGHUP))],
    ids=lambda s: s.name,
)
def test_it_ends_with_the_process_that_started_it(how: signal.Signals) -> None:
    with subprocess.Popen([sys.executable, "-c", STARTS], stdout=subprocess.PIPE, text=True) as starter:
        assert starter.stdout is not None
        pid = int(starter.stdout.readline().split()[0])
        assert alive(pid)
        starter.send_signal(how)
        starter.wait()
        for _ in range(600):  # only a guard: it ends at once
            if not alive(pid):
                break
            time.sleep(0.05)
        assert not alive(pid)
