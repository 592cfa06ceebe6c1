"""Who and what the bench's server refuses."""

from __future__ import annotations

import json
import multiprocessing
import socket
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from command_line import runner
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

from hil.bench.attendant import HOW_TO_LEAVE
from hil.console import starter
from hil.console.admission import Admission
from hil.console.app import application
from hil.console.desk import Desk
from hil.console.facts import facts_of
from hil.console.guard import MOST_BYTES, Hosts, is_loopback
from hil.console.serve import Place
from hil.machine import load_machine

OWN = "http://127.0.0.1:8710"
TOKEN = "0123456789abcdef"
SOCKETS = ("ws://127.0.0.1:8710/control", "ws://127.0.0.1:8710/rows")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


def client_of(folder: Path, token: str = TOKEN, bound: str = "127.0.0.1", base: str = OWN) -> TestClient:
    ours, theirs = multiprocessing.Pipe()
    facts = facts_of("turntable", load_machine("turntable"), "lockstep:")
    client = TestClient(application(Desk(facts, folder, ours), Admission(token), Hosts(bound, ("arm.example",))), base_url=base)
    client.starter = theirs  # type: ignore[attr-defined]  # kept open
    return client


@pytest.fixture
def client(folder: Path) -> Iterator[TestClient]:
    with client_of(folder) as client:
        client.get(f"/enter?token={TOKEN}")
        yield client


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8710", "127.0.0.1.evil.example", "192.0.2.7:8710", "", "127.0.0.1@evil.example"]
)
def test_a_server_on_loopback_answers_to_no_other_name(client: TestClient, host: str) -> None:
    assert client.get("/", headers={"Host": host}).status_code == 421


@pytest.mark.parametrize("host", ["127.0.0.1:8710", "localhost:1", "[::1]:8710"])
def test_a_server_on_loopback_answers_to_its_own_names(folder: Path, host: str) -> None:
    with client_of(folder) as client:
        assert client.get(f"/enter?token={TOKEN}", headers={"Host": host}, follow_redirects=False).status_code == 303


def test_a_server_for_others_answers_to_its_addresses_and_names_alone(folder: Path) -> None:
    with client_of(folder, TOKEN, "0.0.0.0") as client:
        assert client.get("/", headers={"Host": "192.0.2.7:8710"}).status_code == 401
        assert client.get("/", headers={"Host": "arm.example"}).status_code == 401
        assert client.get("/", headers={"Host": "evil.example"}).status_code == 421


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "127.0.0.1", "::1"])
def test_the_address_that_is_printed_names_this_server_to_other_computers_too(host: str) -> None:
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as listening:
        listening.bind((host, 0))
        address = urlsplit(Place(host, 0, TOKEN).address(listening))
        assert address.port == listening.getsockname()[1]
    assert Hosts(host).allow(address.netloc)
    assert address.hostname == (host if is_loopback(host) else socket.gethostname().lower())


@pytest.mark.parametrize("origin", [None, "http://evil.example", "http://127.0.0.1:9999", "null", "http://127.0.0.1:8710.evil.example"])
def test_pages_of_other_origins_change_nothing(client: TestClient, origin: str | None) -> None:
    headers = {} if origin is None else {"Origin": origin}
    assert client.post("/api/stop", headers=headers).status_code == 403
    for path in SOCKETS:
        with pytest.raises(WebSocketDisconnect), client.websocket_connect(path, headers=headers):
            pass


@pytest.mark.parametrize("path", SOCKETS)
def test_sockets_answer_to_no_other_name(client: TestClient, path: str) -> None:
    headers = {"Host": "evil.example", "Origin": "http://evil.example"}
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(path, headers=headers):
        pass


def test_its_own_page_is_heard(client: TestClient) -> None:
    assert client.post("/api/stop", headers={"Origin": OWN}).status_code == 200
    with client.websocket_connect(SOCKETS[0], headers={"Origin": OWN}) as socket:
        assert socket.receive_json()["type"] == "welcome"


def test_a_release_is_refused_while_nothing_is_held(folder: Path) -> None:
    with client_of(folder) as client:
        client.get(f"/enter?token={TOKEN}")
        line = client.starter  # type: ignore[attr-defined]
        assert client.post("/api/release", headers={"Origin": OWN}).status_code == 409
        with client.websocket_connect(SOCKETS[0], headers={"Origin": OWN}) as page:
            named = {"Origin": OWN, "X-Client": page.receive_json()["client"]}
            assert client.post("/api/run", json={"kind": "static"}, headers=named).json() == {}
            early = client.post("/api/release", headers=named, json={"axis": "turn"})
            assert (early.status_code, len(early.text.splitlines())) == (409, 1)
            line.send((starter.SAID, f"turn held by its drive. {HOW_TO_LEAVE}", True))
            while not page.receive_json()["work"].get("holds"):
                page.send_text("here")
            for unnamed in ({}, {"axis": "another"}, {"axis": ["turn"]}, ["turn"]):
                assert client.post("/api/release", headers=named, json=unnamed).status_code == 422
            assert client.post("/api/release", headers=named).status_code == 422
            assert client.post("/api/release", headers=named, json={"axis": "turn"}).status_code == 200
        sent = []
        while line.poll():
            sent.append(line.recv())
        assert [each for each in sent if each[0] == starter.SAY] == [(starter.SAY, "release turn")]


def test_each_client_is_told_whether_the_work_is_its_own_and_no_name_of_another(client: TestClient) -> None:
    def lines_of(page: WebSocketTestSession) -> tuple[str, str]:
        text = page.receive_text()
        while json.loads(text)["work"]["state"] != "running":
            text = page.receive_text()
        return text, page.receive_text()

    with (
        client.websocket_connect(SOCKETS[0], headers={"Origin": OWN}) as first,
        client.websocket_connect(f"{SOCKETS[0]}?client={(mine := first.receive_json()['client'])}", headers={"Origin": OWN}) as duplicate,
    ):
        other = duplicate.receive_json()["client"]
        assert other != mine
        client.post("/api/run", json={"kind": "static"}, headers={"Origin": OWN, "X-Client": mine})
        for page, own in ((first, True), (duplicate, False)):
            for text in lines_of(page):
                assert json.loads(text)["own"] is own
                assert mine not in text
    with client.websocket_connect(f"{SOCKETS[0]}?client={other}", headers={"Origin": OWN}) as again:
        assert again.receive_json()["client"] == other


def test_a_token_opens_once(folder: Path) -> None:
    with client_of(folder) as client, client_of(folder) as stranger:
        assert client.get("/").status_code == 401
        assert client.get("/enter?token=0123456789abcdeF", follow_redirects=False).status_code == 403
        assert client.get(f"/enter?token={TOKEN}", follow_redirects=False).status_code == 303
        assert client.get("/api/bench").status_code == 200
        with client.websocket_connect(SOCKETS[0], headers={"Origin": OWN}) as socket:
            assert socket.receive_json()["type"] == "welcome"
        session = client.cookies
        client.cookies = type(session)()
        replayed = client.get(f"/enter?token={TOKEN}", follow_redirects=False)
        assert replayed.status_code == 403
        assert "used" in replayed.text
        assert client.get("/api/bench").status_code == 401
        with pytest.raises(WebSocketDisconnect), client.websocket_connect(SOCKETS[1], headers={"Origin": OWN}):
            pass
        assert stranger.get("/", cookies={"isocenter_bench_8710": "guessed"}).status_code == 401


def test_a_second_bench_on_another_port_leaves_the_session_of_the_first(folder: Path) -> None:
    other = OWN.replace("8710", "8711")
    with client_of(folder) as first, client_of(folder, base=other) as second:
        second.cookies = first.cookies  # browsers keep the cookies of all ports together
        for client in (first, second):
            client.get(f"/enter?token={TOKEN}")
        for client in (first, second):
            assert client.get("/api/bench").status_code == 200


@pytest.mark.parametrize("foreign", ['foo={"a": 1}', "foo=a,b; =; \x01", "foo=[1]"])
def test_a_cookie_of_somebody_else_hides_no_session(folder: Path, foreign: str) -> None:
    with client_of(folder) as client:
        given = client.get(f"/enter?token={TOKEN}", follow_redirects=False).headers["set-cookie"].split(";")[0]
        client.cookies.clear()
        assert client.get("/api/bench", headers={"Cookie": f"{foreign}; {given}"}).status_code == 200


def test_a_page_that_keeps_a_motion_going_can_stop_it_after_its_session(folder: Path) -> None:
    with client_of(folder) as client:
        client.get(f"/enter?token={TOKEN}")
        with client.websocket_connect(SOCKETS[0], headers={"Origin": OWN}) as socket:
            client.cookies.clear()
            assert client.post("/api/stop", headers={"Origin": OWN}).status_code == 401
            socket.send_text("stop")
            while (told := socket.receive_json())["type"] != "stop heard":
                assert told.get("stop") is None
            while not (told := socket.receive_json())["stop"]:
                pass
            assert told["stop"]["by"].startswith("STOP in a browser at ")


def test_a_session_is_out_of_reach_of_scripts_and_other_sites(folder: Path) -> None:
    with client_of(folder) as client:
        cookie = client.get(f"/enter?token={TOKEN}", follow_redirects=False).headers["set-cookie"].lower()
        assert "httponly" in cookie
        assert "samesite=strict" in cookie


def test_a_browser_that_is_in_invites_another_once(folder: Path) -> None:
    with client_of(folder) as client:
        client.get(f"/enter?token={TOKEN}")
        address = client.post("/api/invite", headers={"Origin": OWN}).json()["address"]
        client.cookies.clear()
        assert client.get(address, follow_redirects=False).status_code == 303
        client.cookies.clear()
        assert client.get(address, follow_redirects=False).status_code == 403


def test_long_bodies_are_refused(client: TestClient) -> None:
    body = b'{"step": "' + MOST_BYTES * b"x" + b'"}'
    assert client.post("/api/step", content=body, headers={"Origin": OWN}).status_code == 413


@pytest.mark.parametrize("body", [b"", b"[]", b"{", b'"x"', b"\xff"])
def test_a_body_that_is_no_object_is_refused(client: TestClient, body: bytes) -> None:
    answer = client.post("/api/run", content=body, headers={"Origin": OWN})
    assert (answer.status_code, answer.text) == (400, "a JSON object is asked for\n")


@pytest.mark.parametrize("what", [{}, {"step": "fly"}, {"step": ["home"]}, {"step": "check", "values": []}])
def test_what_is_no_step_is_told(client: TestClient, what: dict[str, object]) -> None:
    answer = client.post("/api/step", json=what, headers={"Origin": OWN})
    assert len(answer.json()["error"].splitlines()) == 1


def test_no_file_outside_of_the_folder_is_shown(client: TestClient, folder: Path) -> None:
    (folder.parent / "secret.json").write_text("{}")
    (folder / "link.json").symlink_to(folder.parent / "secret.json")
    (folder / ".hidden.json").write_text("{}")
    (folder / "good.json").write_text("{}")
    for name in ("..%2fsecret.json", "../secret.json", "%2fetc%2fpasswd", "link.json", ".hidden.json", "%00.json", "", "."):
        assert client.get(f"/files/{name}").status_code in (404, 405), name
    assert client.get("/files/good.json").status_code == 200


def test_a_report_has_none_of_the_rights_of_the_page(client: TestClient, folder: Path) -> None:
    (folder / "report.html").write_text("<script>fetch('/api/stop', {method: 'POST'})</script>")
    policy = client.get("/files/report.html").headers["content-security-policy"]
    assert "sandbox" in policy
    assert "allow-same-origin" not in policy
    assert "default-src 'none'" in policy


def test_the_page_is_in_no_frame_and_loads_from_nowhere_else(client: TestClient) -> None:
    headers = client.get("/").headers
    assert headers["x-frame-options"] == "DENY"
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert "default-src 'self'" in headers["content-security-policy"]


@pytest.mark.parametrize(
    ("options", "wrong"),
    [
        (("--host", "192.0.2.7"), "cannot listen there"),
        (("--token", "short"), "at least 16"),
        (("--token", "a token with blanks in it"), "letters, digits"),
        (("--host", "192.0.2.7", "--token", TOKEN), "cannot listen there"),
    ],
)
def test_a_token_that_is_guessed_and_an_impossible_place_are_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, options: tuple[str, ...], wrong: str
) -> None:
    outcome = runner(capsys)("bench", "turntable", "--bus", "lockstep:", "-o", tmp_path / "out", *options)
    assert outcome.status == 2
    assert wrong in outcome.line
