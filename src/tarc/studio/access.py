"""Who may use the page: the computer itself, or who has the token; and the folders of the sessions."""

import hmac
import ipaddress
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import IO, Any
from urllib.parse import parse_qsl, urlencode

from tarc.core.errors import InvalidParameter

try:
    import fcntl
except ImportError:  # Windows: folders of killed servers stay
    fcntl = None

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

LOOPBACK = "127.0.0.1"
COOKIE = "tarc-studio"
PREFIX = "tarc-studio-"
MAX_BODY = 40 << 20
"""Largest request [B]: an upload and what the form adds to it."""
HEADERS = {
    b"content-security-policy": b"default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; object-src 'none'; "
    b"base-uri 'self'; form-action 'self'; frame-ancestors 'none'",
    b"referrer-policy": b"no-referrer",
    b"x-content-type-options": b"nosniff",
    b"x-frame-options": b"DENY",
}
"""Of every answer: the browser then loads nothing from another computer, and no other page embeds this one."""

_HOST = re.compile(r"(\[[^\]]*\]|[^:@\[\]]*)(?::\d+)?")


def is_loopback(host: str) -> bool:
    """Return whether an address or a name is that of the computer itself."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def new_token(host: str) -> str | None:
    """Return the token that the page needs where it is bound to an address: None on the computer itself.

    Parameters
    ----------
    host
        Address to which the server is bound.
    """
    return None if is_loopback(host) else secrets.token_urlsafe(32)


class Guard:
    """ASGI middleware of all routes, websockets included: token, host, origin, and size of requests.

    Without a token, requests must name the computer itself as their host, so that no foreign name that resolves to it
    reaches the page. With a token, the first visit has it in the URL. The answer sets a cookie and leads to the same
    URL without the token. A request that names another origin is refused in both cases.

    Parameters
    ----------
    app
        The application behind it.
    token
        As of `new_token`.
    max_body
        Largest request [B].
    """

    def __init__(self, app: Application, token: str | None = None, max_body: int = MAX_BODY):
        self._app = app
        self._token = token
        self._max_body = max_body

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or hand it on."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        send = _with_headers(send)
        if not self._has_right_host(headers):
            await _refuse(scope, send, 403, "This page is for the computer itself, and for pages of its own.")
        elif self._is_allowed(headers) and _length(headers) > self._max_body:
            await _refuse(scope, send, 413, f"Too large: at most {self._max_body >> 20} MB.")
        elif self._is_allowed(headers):
            await self._app(scope, _limited(receive, self._max_body), send)
        elif scope["type"] == "http" and self._is_token(_query(scope).get("token", "")):
            await self._welcome(scope, send)
        else:
            await _refuse(scope, send, 401, "Open the address that the command printed; it has the token.")

    def _has_right_host(self, headers: dict[str, str]) -> bool:
        """Return whether host and origin of a request are those of the page."""
        host = headers.get("host", "")
        origin = headers.get("origin")
        name = _HOST.fullmatch(host)
        if self._token is None and not (name and is_loopback(name[1])):
            return False
        return origin is None or origin.partition("://")[2] == host

    def _is_allowed(self, headers: dict[str, str]) -> bool:
        """Return whether a request needs no token, or has its cookie."""
        if self._token is None:
            return True
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        except CookieError:
            return False
        return cookie is not None and self._is_token(cookie.value)

    def _is_token(self, text: str) -> bool:
        """Compare in a time that does not depend on where the texts differ."""
        return self._token is not None and hmac.compare_digest(text.encode(), self._token.encode())

    async def _welcome(self, scope: Scope, send: Send) -> None:
        """Set the cookie and lead to the URL without the token."""
        rest = {name: value for name, value in _query(scope).items() if name != "token"}
        # one slash: //name would be another computer
        target = f"/{scope['path'].lstrip('/')}{'?' if rest else ''}{urlencode(rest)}"
        cookie = f"{COOKIE}={self._token}; Path=/; HttpOnly; SameSite=Strict"
        headers = [(b"location", target.encode("ascii", "ignore")), (b"set-cookie", cookie.encode())]
        await send({"type": "http.response.start", "status": 303, "headers": headers})
        await send({"type": "http.response.body", "body": b""})


def _query(scope: Scope) -> dict[str, str]:
    return dict(parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True))


def _length(headers: dict[str, str]) -> int:
    """Return the size of a request [B] as its header has it, 0 where it has none."""
    text = headers.get("content-length", "")
    return int(text) if text.isdecimal() else 0


async def _refuse(scope: Scope, send: Send, status: int, text: str) -> None:
    """Answer with a status and a text; a websocket is closed before it is accepted."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": text.encode()})


def _with_headers(send: Send) -> Send:
    """Return a function that adds the headers of the page to every answer."""

    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", []), *HEADERS.items()]}
        await send(message)

    return send_with_headers


def _limited(receive: Receive, max_body: int) -> Receive:
    """Return a function that ends a request which is too large, as if the browser had left."""
    received = 0

    async def receive_limited() -> Message:
        nonlocal received
        message = await receive()
        if message["type"] == "http.request":
            received += len(message.get("body", b""))
            if received > max_body:
                return {"type": "http.disconnect"}
        return message

    return receive_limited


class SessionFolders:
    """Folders of the sessions, each for one alone; all of them vanish with the server.

    Parameters
    ----------
    parent
        Folder in which they are; None for the system's folder of temporary files. Those that a killed server left
        there are removed.

    Raises
    ------
    InvalidParameter
        For a folder that cannot be written.
    """

    def __init__(self, parent: Path | None = None):
        base = Path(tempfile.gettempdir()) if parent is None else parent
        _remove_abandoned(base)
        try:
            self.root = Path(tempfile.mkdtemp(prefix=PREFIX, dir=base))
        except OSError as error:
            raise InvalidParameter(f"parent: cannot write {base}: {error.strerror}; choose another folder") from None
        self._lock = (self.root / "lock").open("w")
        _try_lock(self._lock)

    def create(self) -> Path:
        """Make the folder of a new session, with a name that cannot be guessed, for the user of the server alone."""
        return Path(tempfile.mkdtemp(dir=self.root))

    def remove(self, folder: Path) -> None:
        """Remove the folder of a session, with all that is in it."""
        if folder.parent != self.root:
            raise InvalidParameter(f"folder: got {str(folder)!r}; needs a folder that this object made")
        shutil.rmtree(folder, ignore_errors=True)

    def close(self) -> None:
        """Remove all folders."""
        shutil.rmtree(self.root, ignore_errors=True)
        self._lock.close()


def _remove_abandoned(base: Path) -> None:
    """Remove the folders of servers that no longer run: those of this user whose lock is free."""
    user = os.getuid() if hasattr(os, "getuid") else 0
    for folder in base.glob(f"{PREFIX}*"):
        if folder.is_symlink() or not folder.is_dir() or folder.stat().st_uid != user:
            continue
        lock = folder / "lock"
        if lock.is_file() and not lock.is_symlink():
            with lock.open() as stream:
                is_abandoned = _try_lock(stream)
            if is_abandoned:
                shutil.rmtree(folder, ignore_errors=True)


def _try_lock(stream: IO[str]) -> bool:
    """Take the lock of a file, and return whether no other process has it."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
