"""The server of the page: this machine alone, and only for who knows the token of its address.

Every request is checked for the token (in the path), for ``Host`` (no other name may lead here) and for ``Origin``
(no page from elsewhere may ask), and bodies are JSON of a limited size.
"""

from __future__ import annotations

import hmac
import json
import secrets
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from .session import Refused, Session

HERE = Path(__file__).parent

USUAL_PORT = 8642
"""Port that is taken if it is free."""

MOST_BYTES = 2_000_000
"""Size of a request."""

LONGEST_WAIT = 20.0
"""Seconds after which a question for news is answered anyway."""

PATIENCE = 60.0
"""Seconds that a connection may be silent."""

TEMPLATES = ("robot", "cart", "unicycle")
"""Files ``template_*.toml`` to begin with."""

_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; connect-src 'self'; img-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class Studio:
    """A running page.

    Parameters
    ----------
    folder : Path
        The only folder that is written to.
    name : str
        The file that is edited.
    port : int
        0: any that is free.
    token : str, optional
        Secret in the address; default: a new one.
    text : str, optional
        Text to begin with where the file does not exist.
    """

    def __init__(
        self, folder: Path, name: str, port: int = 0, token: str | None = None, text: str | None = None
    ) -> None:
        self.token = secrets.token_urlsafe(24) if token is None else token
        self.session = Session(folder, name, text)
        try:
            self._server = _Server(("127.0.0.1", port), self.token, self.session)
        except OSError:
            self.session.close()
            raise
        self._thread: threading.Thread | None = None
        _looks()  # while the first text is being read

    @property
    def address(self) -> str:
        """Where the page is, token included."""
        return f"http://127.0.0.1:{self._server.server_port}/{self.token}/"

    def start(self) -> Studio:
        """Serve in a thread of its own."""
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
        self._thread.start()
        return self

    def wait(self) -> None:
        """Return when the server was stopped."""
        while self._thread is not None and self._thread.is_alive():
            self._thread.join(0.5)

    def stop(self) -> None:
        """Stop serving, and end all processes."""
        self.session.close()
        self._server.shutdown()
        self._server.server_close()
        self._server.break_off()


def open_studio(folder: Path, name: str | None, port: int | None = None) -> Studio:
    """Return a running page.

    Parameters
    ----------
    folder : Path
        The only folder that is written to.
    name : str or None
        The file in it that is edited; it need not exist. None: a new one, with a small task to begin with.
    port : int, optional
        Default: ``USUAL_PORT``, so that texts that the browser keeps are found again, or another one if it is in use.

    Raises
    ------
    ValueError
        If the name is not that of a TOML file in the folder, it cannot be read, or the port is in use.
    """
    text = None
    if name is None:
        name = next(n for n in (f"task{k or ''}.toml" for k in range(10**6)) if not (folder / n).exists())
        text = _text("template_first.toml")
    try:
        return Studio(folder, name, USUAL_PORT if port is None else port, text=text).start()
    except OSError:
        if port is not None:
            raise ValueError(f"`--port`: expected a port that is free, got {port}, which is in use") from None
        return Studio(folder, name, text=text).start()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, place: tuple[str, int], token: str, session: Session) -> None:
        self.token, self.session = token, session
        self._open = set[socket.socket]()
        super().__init__(place, _Handler)

    def get_request(self) -> tuple[socket.socket, Any]:
        """Accept a connection, and remember it."""
        connection, address = super().get_request()
        self._open.add(connection)
        return connection, address

    def shutdown_request(self, request: Any) -> None:
        """Forget a connection that ends."""
        self._open.discard(request)
        super().shutdown_request(request)

    def break_off(self) -> None:
        """End the connections that are open: they would outlive the server, and answer in its name."""
        for connection in [*self._open]:
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Connections that break are no news."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "certigym", ""
    timeout = PATIENCE

    def log_message(self, format: str, *args: Any) -> None:
        """Addresses hold the token: they are not printed."""

    def do_GET(self) -> None:
        """Answer with the page, its parts, or the state."""
        rest = self._rest()
        if rest is None:
            return
        path, query = urlsplit(rest).path, parse_qs(urlsplit(rest).query)
        session = self.server.session
        if path == "state":
            self._json(200, session.state(_whole(query.get("since")), LONGEST_WAIT))
        elif path in FILES:
            kind, make = FILES[path]
            self._send(200, kind, make().encode("utf-8"))
        else:
            self._json(404, {"error": "nothing here"})

    def do_POST(self) -> None:
        """Do what the page asks for."""
        rest = self._rest()
        if rest is None:
            return
        body = self._body()
        if body is None:
            return
        session = self.server.session
        actions: dict[str, Callable[[], None]] = {
            "text": lambda: session.put_text(body.get("text"), body.get("base")),
            "edit": lambda: session.edit(body.get("edit"), body.get("base")),
            "certify": lambda: session.certify(body.get("seconds")),
            "stop": session.stop,
            "play": lambda: session.play(body.get("seed", 0)),
            "save": lambda: session.save(body.get("anyway") is True),
            "certificate": lambda: session.save_certificate(body.get("name")),
        }
        if rest not in actions:
            self._json(404, {"error": "nothing here"})
            return
        try:
            actions[rest]()
        except Refused as refusal:
            self._json(409, {"error": str(refusal), "state": session.state(-1, 0.0)})
        except (ValueError, OSError) as error:
            self._json(400, {"error": str(error)})
        else:
            self._json(200, session.state(-1, 0.0))

    def _rest(self) -> str | None:
        """Return the address behind the token; None if the request was refused, and answered."""
        own = f"127.0.0.1:{self.server.server_port}"
        origin = self.headers.get("Origin")
        site = self.headers.get("Sec-Fetch-Site", "none")
        _, token, rest = [*self.path.split("/", 2), "", ""][:3]
        if self.headers.get_all("Host") != [own]:
            self._refuse(403, "this address is for this machine alone")
        elif origin not in (None, f"http://{own}") or site not in ("none", "same-origin"):
            self._refuse(403, "pages from elsewhere may not ask")
        elif not hmac.compare_digest(token.encode("utf-8", "replace"), self.server.token.encode()):
            self._refuse(403, "the token is missing or wrong: open the address that the command prints")
        else:
            return rest
        return None

    def _body(self) -> dict[str, Any] | None:
        """Return the body of a request; None if it was refused, and answered."""
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()) or "Transfer-Encoding" in self.headers:
            self._refuse(411, "expected a length")
        elif int(length) > MOST_BYTES:
            self._refuse(413, f"expected at most {MOST_BYTES} bytes")
        elif self.headers.get_content_type() != "application/json":
            self._refuse(415, "expected JSON")
        else:
            try:
                body = json.loads(self.rfile.read(int(length)))
            except (ValueError, RecursionError):
                body = None
            if isinstance(body, dict):
                return body
            self._refuse(400, "expected a JSON object")
        return None

    def _refuse(self, status: int, why: str) -> None:
        """Refuse a request whose body was not read: the connection ends."""
        self.close_connection = True
        self._json(status, {"error": why})

    def _json(self, status: int, data: Any) -> None:
        self._send(status, "application/json", json.dumps(data).encode("utf-8"))

    def _send(self, status: int, kind: str, data: bytes) -> None:
        self.send_response(status)
        headers = {
            "Content-Type": f"{kind}; charset=utf-8",
            "Content-Length": str(len(data)),
            "Cache-Control": "no-store",
            "Content-Security-Policy": _POLICY,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
        }
        if self.close_connection:
            headers["Connection"] = "close"
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(data)


def _whole(values: list[str] | None) -> int:
    """Return the number of a query; -1 if it is none."""
    text = values[0] if values else ""
    return int(text) if text.isascii() and text.isdigit() and len(text) < 16 else -1


def _text(name: str) -> str:
    return (HERE / name).read_text(encoding="utf-8")


@cache
def _looks() -> tuple[str, str]:
    """Return style sheet and hatches, which are those of reports.

    They are loaded here: processes that read texts import this file, and have no use for them.
    """
    from ..reports import PATTERNS, STYLE

    return STYLE, PATTERNS


def _page() -> str:
    """Return the page; beginnings of tasks stand in it as templates."""
    templates = "".join(f'<template id="begin-{n}">{_text(f"template_{n}.toml")}</template>' for n in TEMPLATES)
    return _text("page.html").replace("<!-- patterns -->", _looks()[1]).replace("<!-- templates -->", templates)


SCRIPTS = ("page.js", "link.js", "editor.js", "picture.js", "result.js")

FILES: dict[str, tuple[str, Callable[[], str]]] = {
    "": ("text/html", _page),
    "page.css": ("text/css", lambda: _looks()[0] + _text("page.css")),
}
FILES |= {name: ("text/javascript", partial(_text, name)) for name in SCRIPTS}
"""What is served: kind and content."""
