"""Meshcat's server for this machine alone: nobody else reaches it, and it ends with the process that started it.

Run as a script it serves until its standard input ends. That is a pipe from the process that started it, which the system closes
however that process ends, by a signal that cannot be caught as well.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from typing import Any

HOSTS = r"^(127\.0\.0\.1|localhost)$"  # as a browser names this machine; a page of elsewhere comes with its own name
START_SECONDS = 60.0  # to wait for a server that ends


def start_server() -> tuple[subprocess.Popen[bytes], str]:
    """Start the server; returns its process and the address for commands to it.

    Raises
    ------
    ValueError
        It did not start: its last words.
    """
    with tempfile.TemporaryFile() as words:
        process = subprocess.Popen(
            # -P: meshcat is the library, not the file of that name beside this one
            [sys.executable, "-P", "-u", __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=words,
            start_new_session=True,  # an interrupt of a notebook's cell is none of the server's
        )
        assert process.stdout is not None
        line = process.stdout.readline().decode().strip()
        if not line:
            process.wait(START_SECONDS)
            words.seek(0)
            said = words.read().decode(errors="replace").strip().splitlines() or ["no word of why"]
            raise ValueError(f"the viewer's server did not start: {said[-1]}")
    return process, line


def _serve() -> None:
    import tornado.ioloop
    import tornado.web
    from meshcat.servers import zmqserver

    class LoopbackApplication(tornado.web.Application):
        """Listens on the loopback alone, and answers to this machine's own names."""

        def __init__(self, handlers: list[Any]) -> None:
            super().__init__([(r".*", tornado.web.ErrorHandler, {"status_code": 403})])
            self.add_handlers(HOSTS, handlers)

        def listen(self, port: int, address: str | None = None, **options: Any) -> Any:
            return super().listen(port, address or "127.0.0.1", **options)

    class LoopbackBridge(zmqserver.ZMQWebSocketBridge):  # type: ignore[misc]
        """Meshcat's server but for where it listens."""

        def make_app(self) -> LoopbackApplication:
            files = {"path": zmqserver.VIEWER_ROOT, "default_filename": zmqserver.VIEWER_HTML}
            static = (r"/static/(.*)", zmqserver.StaticFileHandlerNoCache, files)
            return LoopbackApplication([static, (r"/", zmqserver.WebSocketHandler, {"bridge": self})])

    bridge = LoopbackBridge()
    loop = tornado.ioloop.IOLoop.current()
    # nothing is ever written there: what can be read is its end
    loop.add_handler(sys.stdin.fileno(), lambda _fd, _events: loop.stop(), loop.READ)
    print(bridge.zmq_url, flush=True)
    bridge.run()


if __name__ == "__main__":
    _serve()
