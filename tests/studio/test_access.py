"""The guard of all routes against strangers, foreign names and foreign pages; folders that vanish."""

import asyncio
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import pytest

from tarc.core.errors import InvalidParameter
from tarc.studio.access import (
    COOKIE,
    HEADERS,
    Guard,
    Message,
    Receive,
    Scope,
    Send,
    SessionFolders,
    is_loopback,
    new_token,
)

TOKEN = "a-token"
LOCAL = "127.0.0.1:8080"
REMOTE = "robot.example:8080"
KEY = {"cookie": f"{COOKIE}={TOKEN}"}


class Answer(NamedTuple):
    """Status, 0 for a websocket that was closed; headers and text."""

    status: int
    headers: dict[str, str]
    text: str


async def page(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer with the size of the request."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    size, more = 0, True
    while more:
        message = await receive()
        more = message.get("more_body", False)
        size += len(message.get("body", b""))
        if message["type"] == "http.disconnect":
            return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": f"design {size}".encode()})


def ask(
    path: str,
    token: str | None = TOKEN,
    host: str = REMOTE,
    kind: str = "http",
    headers: Mapping[str, str] | None = None,
    chunks: tuple[bytes, ...] = (b"",),
) -> Answer:
    """Send a request through the guard."""
    path, _, query = path.partition("?")
    pairs = {"host": host, **(headers or {})}
    scope = {
        "type": kind,
        "path": path,
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode()) for name, value in pairs.items()],
    }
    sent: list[Message] = []
    left = list(chunks)

    async def receive() -> Message:
        return {"type": "http.request", "body": left.pop(0), "more_body": bool(left)}

    async def send(message: Message) -> None:
        sent.append(message)

    asyncio.run(Guard(page, token, max_body=1000)(scope, receive, send))
    if not sent or sent[0]["type"] == "websocket.close":
        return Answer(0, {}, "")
    if kind == "websocket":
        return Answer(101, {}, sent[0]["type"])
    found = {name.decode(): value.decode() for name, value in sent[0]["headers"]}
    return Answer(sent[0]["status"], found, sent[1]["body"].decode())


def test_addresses_of_the_computer_itself_need_no_token() -> None:
    for host in ("127.0.0.1", "localhost", "::1", "[::1]", "127.3.2.1"):
        assert is_loopback(host)
        assert new_token(host) is None
    for host in ("0.0.0.0", "::", "192.168.0.2", "localhost.example", ""):
        assert not is_loopback(host)
        assert len(new_token(host) or "") > 40
    assert new_token("0.0.0.0") != new_token("0.0.0.0")


@pytest.mark.parametrize(
    "path", ["/", "/static/file", "/?token=", "/?token=wrong", "/static?token=é", "/?token=a&token="]
)
def test_nothing_is_served_without_the_token(path: str) -> None:
    answer = ask(path)
    assert answer.status == 401
    assert "design" not in answer.text


def test_the_token_is_in_the_url_once_and_then_in_a_cookie() -> None:
    first = ask(f"/?token={TOKEN}&window=0.01")
    assert first.status == 303
    assert first.headers["location"] == "/?window=0.01"
    value, *attributes = first.headers["set-cookie"].split("; ")
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} == set(attributes)
    assert first.text == ""
    for path in ("/", "/static/file"):
        assert ask(path, headers={"cookie": value}).text == "design 0"


def test_the_redirect_stays_on_the_computer() -> None:
    for path in ("//evil.example/x", "///evil.example/x"):
        assert ask(f"{path}?token={TOKEN}").headers["location"] == "/evil.example/x"


@pytest.mark.parametrize("cookie", [f"{COOKIE}=wrong", f"{COOKIE}=", "a=b", "\x01=;;", f"other={TOKEN}", f"{COOKIE}=é"])
def test_wrong_cookies_are_refused(cookie: str) -> None:
    assert ask("/", headers={"cookie": cookie}).status == 401


def test_websockets_need_the_cookie() -> None:
    for path in ("/socket", f"/socket?token={TOKEN}"):
        assert ask(path, kind="websocket").status == 0
    assert ask("/socket", kind="websocket", headers=KEY).text == "websocket.accept"


@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_foreign_pages_are_refused_even_with_the_cookie(kind: str) -> None:
    for origin in ("http://evil.example", "null", "http://robot.example:81"):
        assert ask("/", kind=kind, headers={**KEY, "origin": origin}).status in (0, 403)
        assert ask("/", None, LOCAL, kind, {"origin": origin}).status in (0, 403)
    assert ask("/", kind=kind, headers={**KEY, "origin": f"http://{REMOTE}"}).status in (101, 200)


@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_foreign_names_of_the_computer_are_refused(kind: str) -> None:
    """A name that resolves to 127.0.0.1 lets a foreign page reach a local server, unless its name is checked."""
    for host in ("evil.example", "evil.example:8080", "127.0.0.1.evil.example", "", "127.0.0.1@evil.example", "[::1"):
        assert ask("/", None, host, kind).status in (0, 403)
    for host in (LOCAL, "localhost:8080", "[::1]:8080"):
        assert ask("/", None, host, kind).status in (101, 200)


def test_large_requests_are_refused() -> None:
    assert ask("/", headers=KEY, chunks=(bytes(600), bytes(400))).text == "design 1000"
    assert ask("/", headers={**KEY, "content-length": "1001"}).status == 413
    assert ask("/", headers=KEY, chunks=(bytes(600), bytes(401), bytes(1))).status == 0


def test_every_answer_forbids_other_computers() -> None:
    for answer in (ask("/"), ask("/", headers=KEY), ask(f"/?token={TOKEN}")):
        for name, value in HEADERS.items():
            assert answer.headers[name.decode()] == value.decode()


def test_folders_are_for_one_session_and_vanish(tmp_path: Path) -> None:
    folders = SessionFolders(tmp_path)
    first, second = folders.create(), folders.create()
    assert first != second
    assert stat.S_IMODE(first.stat().st_mode) == 0o700
    (first / "file").write_text("x")
    folders.remove(first)
    assert not first.exists()
    assert second.exists()
    with pytest.raises(InvalidParameter, match="needs a folder that this object made"):
        folders.remove(tmp_path)
    folders.close()
    assert not list(tmp_path.iterdir())


def test_folders_of_killed_servers_are_removed_and_others_stay(tmp_path: Path) -> None:
    running = SessionFolders(tmp_path)
    killed = SessionFolders(tmp_path)
    killed._lock.close()
    foreign = tmp_path / "tarc-studio-link"
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "lock").write_text("")
    foreign.symlink_to(outside)
    new = SessionFolders(tmp_path)
    assert not killed.root.exists()
    assert running.root.exists()
    assert (outside / "lock").exists()
    running.close()
    new.close()
