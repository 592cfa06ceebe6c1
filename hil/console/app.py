"""The pages and sockets of the bench."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import anyio
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from hil.bench.attendant import CONFIRM
from hil.console.admission import Admission
from hil.console.attention import PING_S
from hil.console.commands import Answers, Command, Order, run_command
from hil.console.desk import Desk
from hil.console.guard import ENTRANCE, PAGE_OF_A_FILE, Guard, Hosts, cookie_name
from hil.console.rows import Reader
from hil.console.verdicts import recorded
from hil.errors import UnusableInputError
from hil.files.unused import unused_folder

STATIC = Path(__file__).parent / "static"
UPLOT = Path(__file__).parents[1] / "pages" / "uplot"
JSON = "application/json"
STOP = "stop"
MOVE = "move "
"""How a message of the page's line begins that orders a motion, renewed for as long as a button is held."""
SESSION_S = 43_200
UNANSWERED = ("inconclusive", "misconfigured")
"""Verdicts of a diagnosis that name no physics and clear none: `isocenter diagnose` ends with status 1."""

Answering = Callable[[Request], Awaitable[Response]]


def application(desk: Desk, admission: Admission, hosts: Hosts) -> Starlette:
    """Return the ASGI application around a desk."""
    pages = _Pages(desk, admission)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        await desk.open()
        try:
            yield
        finally:
            await desk.close()

    return Starlette(
        routes=[
            Route("/", pages.front),
            Route(ENTRANCE, pages.enter),
            Route("/api/bench", pages.bench),
            Route("/api/files", pages.files),
            Route("/api/preview", _told(pages.preview), methods=["POST"]),
            Route("/api/step", _told(pages.step), methods=["POST"]),
            Route("/api/run", _told(pages.run), methods=["POST"]),
            Route("/api/look", _told(pages.look), methods=["POST"]),
            Route("/api/curves", _told(pages.curves), methods=["POST"]),
            Route("/api/demo", _told(pages.demo), methods=["POST"]),
            Route("/api/move", _told(pages.move), methods=["POST"]),
            Route("/api/connect", _told(pages.connect), methods=["POST"]),
            Route("/api/stop", pages.stop, methods=["POST"]),
            Route("/api/release", pages.release, methods=["POST"]),
            Route("/api/invite", pages.invite, methods=["POST"]),
            Route("/files/{name:path}", pages.file),
            WebSocketRoute("/control", pages.control),
            WebSocketRoute("/rows", pages.rows),
            Mount("/static", StaticFiles(directory=STATIC)),
            Mount("/uplot", StaticFiles(directory=UPLOT)),
        ],
        middleware=[Middleware(Guard, admission=admission, hosts=hosts)],
        lifespan=lifespan,
    )


class _Pages:
    """What each address answers."""

    def __init__(self, desk: Desk, admission: Admission) -> None:
        self._desk, self._admission = desk, admission

    async def front(self, request: Request) -> Response:
        return FileResponse(STATIC / "index.html")

    async def enter(self, request: Request) -> Response:
        """Exchange a one-time token for a session."""
        session = self._admission.enter(request.query_params.get("token", ""))
        if session is None:
            why = "this token is unknown or was used already; the page of a browser that is in makes another (Invite)"
            return PlainTextResponse(f"{why}\n", 403)
        response = RedirectResponse("/", 303)
        secure = request.url.scheme == "https"
        name = cookie_name(request.headers["host"])
        response.set_cookie(name, session, max_age=SESSION_S, httponly=True, samesite="strict", secure=secure)
        return response

    async def bench(self, request: Request) -> Response:
        return JSONResponse(self._desk.described())

    async def files(self, request: Request) -> Response:
        return JSONResponse(await asyncio.to_thread(self._desk.listing.entries))

    async def file(self, request: Request) -> Response:
        try:
            path = self._desk.listing.path(request.path_params["name"])
        except UnusableInputError as error:
            return PlainTextResponse(f"{error}\n", 404)
        headers = {}
        if path.suffix == ".html":
            inside = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; font-src data:"
            headers["Content-Security-Policy"] = f"{PAGE_OF_A_FILE}; {inside}"
        shown = "inline" if path.suffix in (".html", ".png", ".json") else "attachment"
        kind = "text/plain; charset=utf-8" if path.suffix in (".toml", ".jsonl") else None
        return FileResponse(path, headers=headers, filename=path.name, content_disposition_type=shown, media_type=kind)

    async def preview(self, asked: dict[str, Any], client: str) -> dict[str, Any]:
        return await self._desk.preview(asked.get("kind"), _table(asked, "values"), (client, str(asked.get("card"))))

    async def step(self, asked: dict[str, Any], client: str) -> None:
        self._desk.begin_step(asked.get("step"), _table(asked, "values"), client)

    async def run(self, asked: dict[str, Any], client: str) -> None:
        """Run an experiment from its form, under a name with the time of day."""
        form = self._desk.form(asked.get("kind"))
        text = form.text(self._desk.facts, _table(asked, "values"))
        name = f"{form.kind}-{datetime.now():%Y%m%d-%H%M%S}"
        command = run_command(self._desk.facts, self._desk.folder, name, text)
        self._desk.begin(Order(f"{form.title} ({name})", (command,), judge=lambda answers: recorded(answers[name])), client)

    async def look(self, asked: dict[str, Any], client: str) -> None:
        """Plot, or diagnose, some recordings."""
        folder, machine = self._desk.folder, self._desk.facts.name
        recordings = [str(path) for path in self._desk.listing.recordings(asked.get("files"))]
        if not recordings:
            raise UnusableInputError("choose recordings first")
        if asked.get("what") == "plot":
            page = folder / "plot.html"
            more = [
                argument for each in str(asked.get("derive") or "").split(",") if each.strip() for argument in ("--derive", each.strip())
            ]
            if align := str(asked.get("align") or "").strip():
                more += ["--align", align]
            command = Command("plot", lambda answers: ["plot", *recordings, *more, "-o", str(page)])
            order = Order("Plot", (command,), made=(page.name,))
        elif asked.get("what") == "diagnose":
            held_out = [str(path) for path in self._desk.listing.recordings(asked.get("held_out") or [])]
            held = [argument for each in held_out for argument in ("--held-out", each)]
            arguments = ["diagnose", machine, *recordings, *held, "-o", str(folder / "diagnosis")]
            command = Command("diagnosis", lambda answers: arguments)
            order = Order("Diagnose", (command,), judge=_diagnosed, made=("diagnosis/report.html",))
        else:
            raise UnusableInputError("recordings can be plotted or diagnosed")
        self._desk.begin(order, client)

    async def curves(self, asked: dict[str, Any], client: str) -> Response:
        """Return channels of some recordings, aligned; a derived one by its text."""
        files = self._desk.listing.recordings(asked.get("files"))
        channels = asked.get("channels", [])
        if not files or not isinstance(channels, list):
            raise UnusableInputError("choose recordings first")
        names = [str(each) for each in channels]
        return Response(await self._desk.curves([str(path) for path in files], names, str(asked.get("align") or "")), media_type=JSON)

    async def demo(self, asked: dict[str, Any], client: str) -> None:
        """Hide something in an emulated arm and find it, in a folder of its own."""
        if not self._desk.facts.is_lockstep:
            raise UnusableInputError("the demo is for an emulated bench; in a terminal: isocenter demo")
        out = unused_folder(self._desk.folder / "demo")
        command = Command("demo", lambda answers: ["demo", "-o", str(out)])
        order = Order("Demo", (command,), judge=lambda answers: (True, answers["demo"]["says"]), made=(f"{out.name}/index.html",))
        self._desk.begin(order, client)

    async def move(self, asked: dict[str, Any], client: str) -> None:
        """Order a motion of the live view."""
        self._desk.move_live(client, str(asked.get("order")))

    async def connect(self, asked: dict[str, Any], client: str) -> None:
        """Try again to connect the live view, which has failed."""
        self._desk.live.connect_again()

    async def stop(self, request: Request) -> Response:
        self._desk.stop(_by(request))
        return JSONResponse({})

    async def release(self, request: Request) -> Response:
        """Tell a run that holds an axis whose brake is not proven that the axis, by its name, is supported."""
        holding = next((each for each in (self._desk.work, self._desk.live) if each.holds), None)
        if holding is None:
            return PlainTextResponse("no drive holds an axis that waits for its release\n", 409)
        try:
            asked = await request.json()
        except ValueError:
            asked = None
        axis = asked.get("axis") if isinstance(asked, dict) else None
        if axis not in [each.name for each in self._desk.facts.axes]:
            return PlainTextResponse("name the axis that is supported\n", 422)
        holding.say(f"{CONFIRM} {axis}")
        return JSONResponse({})

    async def invite(self, request: Request) -> Response:
        """Return an address for one more browser."""
        return JSONResponse({"address": f"{request.url.scheme}://{request.headers['host']}{ENTRANCE}?token={self._admission.invite()}"})

    async def control(self, socket: WebSocket) -> None:
        """Send the state, which is the ping, and take the answers; and STOP, which must find a way as long as these keep a motion going."""
        await socket.accept()
        attention = self._desk.attention
        client = attention.welcome(socket.query_params.get("client", ""))

        async def tell() -> None:
            await socket.send_json({"type": "welcome", "client": client})
            seen = -1
            while True:
                version = self._desk.results_version
                await socket.send_text(self._desk.state_text(client, whole=version != seen))
                seen = version
                await asyncio.sleep(PING_S)

        async def listen() -> None:
            while True:
                told = await socket.receive_text()
                attention.heard(client)
                if told == STOP:
                    self._desk.stop(_by(socket))
                    await socket.send_json({"type": "stop heard"})
                elif told.startswith(MOVE):
                    try:
                        self._desk.move_live(client, told.removeprefix(MOVE))
                    except UnusableInputError as error:
                        await socket.send_json({"type": "no move", "why": str(error)})

        try:
            await _until_gone(tell(), listen())
        finally:
            attention.leave(client)

    async def rows(self, socket: WebSocket) -> None:
        """Send the rows of the run, every one of them, as far as the reader takes them."""
        await socket.accept()
        reader = self._desk.rows.join()

        async def tell(reader: Reader) -> None:
            while True:
                message = await reader.next()
                await (socket.send_text(message) if isinstance(message, str) else socket.send_bytes(message))

        async def listen() -> None:
            while True:
                await socket.receive()

        try:
            await _until_gone(tell(reader), listen())
        finally:
            self._desk.rows.leave(reader)


async def _until_gone(*doing: Awaitable[None]) -> None:
    """Do several things until one of them ends, as it does when the client has gone."""
    async with anyio.create_task_group() as group:

        async def do(each: Awaitable[None]) -> None:
            with contextlib.suppress(WebSocketDisconnect, RuntimeError, OSError):
                await each
            group.cancel_scope.cancel()

        for each in doing:
            group.start_soon(do, each)


def _told(answer: Callable[[dict[str, Any], str], Awaitable[Any]]) -> Answering:
    """Return an endpoint that takes a JSON object, and says in one line what cannot be used."""

    async def endpoint(request: Request) -> Response:
        try:
            asked = await request.json()
        except HTTPException:
            raise
        except ValueError:
            asked = None
        if not isinstance(asked, dict):
            return PlainTextResponse("a JSON object is asked for\n", 400)
        try:
            found = await answer(asked, request.headers.get("x-client", ""))
        except UnusableInputError as error:
            return JSONResponse({"error": str(error)})  # an answer to the user, no failure of the request
        return found if isinstance(found, Response) else JSONResponse({} if found is None else found)

    return endpoint


def _by(asker: HTTPConnection) -> str:
    return f"STOP in a browser at {asker.client.host if asker.client else '?'}"


def _table(asked: dict[str, Any], key: str) -> dict[str, Any]:
    values = asked.get(key, {})
    if not isinstance(values, dict):
        raise UnusableInputError(f"{key}: must be a JSON object")
    return values


def _diagnosed(answers: Answers) -> tuple[bool, str]:
    """Judge a diagnosis by its verdict, in its own sentence."""
    diagnosis = answers["diagnosis"]
    return diagnosis["verdict"] not in UNANSWERED, f"{diagnosis['verdict'].replace('_', ' ')}: {diagnosis['reason']}"
