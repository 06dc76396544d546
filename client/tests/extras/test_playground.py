"""Tests the playground's page in Chromium against the client's results from the same server.

Needs a server built with the default features (`make test-playground`). With
HULLCAST_WRITE_PICTURE set, writes docs/playground.png.
"""

from __future__ import annotations

import filecmp
import io
import itertools
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread
from typing import Any
from urllib.parse import parse_qs

import grpc
import numpy as np
import pytest
from PIL import Image

import hullcast
from hullcast._pb import hulls_pb2, server_pb2

sync_api = pytest.importorskip("playwright.sync_api")

ROOT = Path(__file__).resolve().parents[3]
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
BROWSER = next(filter(None, map(shutil.which, BROWSERS)), None)
# Render in software, for machines without a graphics card.
ARGUMENTS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]

pytestmark = pytest.mark.skipif(BROWSER is None, reason="Chromium is not installed")

Page = Any


@pytest.fixture(scope="module")
def server() -> Iterator[hullcast.Client]:
    with hullcast.serve(arguments=["--playground"]) as client:
        yield client


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        # As root, as in containers, Chromium cannot run its sandbox.
        chromium = playwright.chromium.launch(
            executable_path=BROWSER, args=[*ARGUMENTS, "--no-sandbox"]
        )
        yield chromium
        chromium.close()


@contextmanager
def opened(browser: Any, server: hullcast.Client, hash: str = "", **context: Any) -> Iterator[Page]:
    """Opens the page at a scene and waits for its first result; fails if an error was logged."""
    options = {"viewport": {"width": 1360, "height": 960}} | context
    with browser.new_context(**options) as context:
        page = context.new_page()
        page.complaints, page.shapes, page.calls = [], {}, Calls()
        page.planarities = set()
        page.on("pageerror", lambda error: page.complaints.append(str(error)))
        page.on("console", lambda m: m.type == "error" and page.complaints.append(m.text))
        page.on("request", lambda request: note_shape(page, request))
        page.on("request", lambda request: page.calls.begins(request))
        page.on("requestfinished", lambda request: page.calls.ends(request))
        page.goto(f"http://{server.target}/{hash}")
        settled(page)
        yield page
        assert page.complaints == []
        # With another planarity the page's hulls would have other ids and faces than this package's.
        assert page.planarities == {hullcast.DEFAULT_PLANARITY}


class Calls:
    """Counts the page's queries in total, in flight, and in flight at most."""

    def __init__(self) -> None:
        self.count = self.open = self.most = 0

    def begins(self, request: Any) -> None:
        if request.method == "POST":
            self.open += 1
            self.count += 1
            self.most = max(self.most, self.open)

    def ends(self, request: Any) -> None:
        self.open -= request.method == "POST"


def note_shape(page: Page, request: Any) -> None:
    """Keeps the points that the page registers, in their order."""
    if request.url.endswith("/RegisterHulls"):
        message = hulls_pb2.RegisterHullsRequest.FromString(request.post_data_buffer[5:])
        page.planarities.add(message.hulls[0].planarity)
        page.shapes[len(page.shapes)] = np.reshape(message.hulls[0].vertices, (-1, 3))


def settled(page: Page) -> None:
    # Poll no function here: the page's content security policy forbids evaluating code.
    page.wait_for_selector("#answer[aria-busy=false]")


def link(page: Page) -> str:
    """The part of the scene's link after the #."""
    page.click("#share")
    return page.evaluate("location.hash")


def fields(page: Page) -> dict[str, str]:
    return {key: values[0] for key, values in parse_qs(link(page).lstrip("#")).items()}


def numbers(text: str) -> list[float]:
    return [float(value) for value in text.split(",")]


def values(page: Page, selector: str) -> list[float]:
    """The numbers in the elements that a selector matches, with all their digits."""
    texts = page.eval_on_selector_all(selector, "all => all.map(data => data.value)")
    return [float(text) for text in texts]


def check_against_library(
    page: Page, server: hullcast.Client, shapes: list[np.ndarray], **query: Any
) -> hullcast.Manifolds:
    """Asserts that the page's numbers for its link's scene equal the client's, bit for bit."""
    settled(page)
    state = fields(page)
    hulls = server.register(shapes)
    scene = hullcast.Scene(
        hulls,
        np.array([numbers(state[f"{side}.at"]) for side in "ab"]),
        np.array([numbers(state[f"{side}.turn"]) for side in "ab"]),
    )
    accuracy = hullcast.Accuracy(
        solver={"portal": "PORTAL", "gjk": "GJK_RAY_CAST"}[state["solver"]],
        relative_tolerance=float(state["tolerance"]),
        feature_angle=float(state["angle"]),
        max_points=int(state["most"]),
    )
    asked = {"margin": float(state["margin"])} | query
    m = server.query(scene, [[0, 1]], accuracy=accuracy, **asked)
    assert values(page, "#alpha") == m.alpha.tolist()
    assert values(page, "#lower") == m.alpha_lower.tolist()
    assert values(page, "#upper") == m.alpha_upper.tolist()
    assert values(page, "#separation") == m.separation.tolist()
    assert [values(page, f"#normal-{axis}")[0] for axis in "xyz"] == m.normal[0].tolist()
    assert values(page, "#points td:nth-child(2) data") == m.distance.tolist()
    assert values(page, "#points td:nth-child(3) data") == m.witness_a.ravel().tolist()
    return m


def place(page: Page, side: str) -> tuple[float, float]:
    """The position of a hull's label, which is over the hull's centre."""
    box = page.locator(f"#stage .label.{side}").bounding_box()
    return box["x"], box["y"] + box["height"] / 2 + 6


def drag(
    page: Page, side: str, by: tuple[int, int], key: str | None = None, beside: int = 0
) -> None:
    """Drags from `beside` pixels right of a hull's centre, which another hull may hide."""
    x, y = place(page, side)
    x += beside
    page.mouse.move(x, y)
    if key:
        page.keyboard.down(key)
    page.mouse.down()
    for share in np.linspace(0, 1, 12)[1:]:
        page.mouse.move(x + share * by[0], y + share * by[1])
    page.mouse.up()
    if key:
        page.keyboard.up(key)
    settled(page)


def test_the_first_scene_is_the_librarys_answer(browser: Any, server: hullcast.Client):
    with opened(browser, server) as page:
        m = check_against_library(page, server, [page.shapes[0], page.shapes[1]])
        assert len(m.distance) >= 3
        assert page.locator("#plane .overlap").count() == 1
        assert page.locator("#plane .point").count() == len(m.distance)
        assert page.locator("#status").inner_text().startswith("Contact")


@pytest.mark.skipif("HULLCAST_WRITE_PICTURE" not in os.environ, reason="only on demand")
def test_the_picture_of_the_documents(browser: Any, server: hullcast.Client):
    """Not a test: writes docs/playground.png, with a reduced number of colours."""
    with opened(browser, server, viewport={"width": 1280, "height": 1000}) as page:
        page.wait_for_timeout(500)
        picture = Image.open(io.BytesIO(page.screenshot(full_page=True))).convert("RGB")
        few = picture.quantize(method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        few.save(ROOT / "docs/playground.png", optimize=True)


def test_dragging_moves_and_turns(browser: Any, server: hullcast.Client):
    """Dragging has at most one call in flight, and ends with the numbers of the final pose."""
    with opened(browser, server) as page:
        shapes = [page.shapes[0], page.shapes[1]]
        before, picture = fields(page), page.locator("#stage").screenshot()
        drag(page, "b", (0, 60))
        moved = fields(page)
        assert moved["b.at"] != before["b.at"]
        assert [moved[key] for key in ("a.at", "a.turn", "b.turn", "view")] == [
            before[key] for key in ("a.at", "a.turn", "b.turn", "view")
        ]
        check_against_library(page, server, shapes)
        assert page.locator("#stage").screenshot() != picture
        drag(page, "b", (50, 20), key="Shift")
        turned = fields(page)
        assert turned["b.at"] == moved["b.at"]
        assert turned["b.turn"] != moved["b.turn"]
        check_against_library(page, server, shapes)
        page.check("input[value=turn]", force=True)
        drag(page, "a", (30, 0), beside=-110)
        assert fields(page)["a.turn"] != turned["a.turn"]
        check_against_library(page, server, shapes)
        # Dragging beside the hulls moves the camera, and no query is made.
        count, state = page.calls.count, fields(page)
        box = page.locator("#stage canvas").bounding_box()
        page.mouse.move(box["x"] + 12, box["y"] + box["height"] - 12)
        page.mouse.down()
        page.mouse.move(box["x"] + 90, box["y"] + box["height"] - 60)
        page.mouse.up()
        after = fields(page)
        assert after.pop("view") != state.pop("view")
        assert after == state
        assert page.calls.count == count
        assert page.calls.most == 1


def test_nothing_is_asked_while_nothing_changes(browser: Any, server: hullcast.Client):
    with opened(browser, server) as page:
        count = page.calls.count
        assert count >= 5  # registering and reading two hulls, and the query
        page.wait_for_timeout(1000)
        assert page.calls.count == count


def test_sliders_and_fields(browser: Any, server: hullcast.Client):
    with opened(browser, server) as page:
        shapes = [page.shapes[0], page.shapes[1]]
        all_points = len(check_against_library(page, server, shapes).distance)
        page.fill("#most", "2")
        reduced = check_against_library(page, server, shapes)
        assert len(reduced.distance) == 2 < all_points
        assert "Reduced" in page.locator("#flags").inner_text()
        page.focus("#most-range")
        page.keyboard.press("ArrowRight")
        assert len(check_against_library(page, server, shapes).distance) == 3
        page.fill("#tolerance", "0.05")
        wide = check_against_library(page, server, shapes)
        assert wide.alpha_upper[0] - wide.alpha_lower[0] <= 0.05 * wide.alpha_upper[0]
        page.select_option("#solver", "gjk")
        check_against_library(page, server, shapes)
        # A tilted box, whose face counts as the feature only with a wider feature angle.
        page.goto(f"http://{server.target}/#b=box&b.at=0,0,0.36&b.turn=0.02,0,0,0.9998&angle=0")
        settled(page)
        check_against_library(page, server, [shapes[0], page.shapes[2]])
        assert "edge" in page.locator("#feature-b").inner_text()
        page.focus("#angle-range")
        for _ in range(12):
            page.keyboard.press("ArrowRight")
        m = check_against_library(page, server, [shapes[0], page.shapes[2]])
        assert "face" in page.locator("#feature-b").inner_text()
        assert len(m.distance) == 4
        # A value outside the allowed range makes no query.
        count = page.calls.count
        page.fill("#angle", "0.6")
        assert page.locator("#angle").get_attribute("aria-invalid") == "true"
        page.wait_for_timeout(200)
        assert page.calls.count == count


def test_separated_pairs(browser: Any, server: hullcast.Client):
    """Beyond the margin the outcome is SEPARATED, with the numbers for an infinite margin."""
    with opened(browser, server, "#b.at=0.2,0.1,1.5&margin=0.05") as page:
        shapes = [page.shapes[0], page.shapes[1]]
        assert page.locator("#outcome").inner_text() == "Separated"
        assert page.locator("#status").inner_text().startswith("Separated")
        m = check_against_library(page, server, shapes, margin=np.inf)
        assert m.alpha[0] > 1
        page.fill("#margin", "2")
        settled(page)
        assert page.locator("#outcome").inner_text() == "Contact"
        check_against_library(page, server, shapes)


def test_keyboard_alone(browser: Any, server: hullcast.Client):
    with opened(browser, server) as page:
        shapes = [page.shapes[0], page.shapes[1]]
        for _ in range(20):
            page.keyboard.press("Tab")
            if page.evaluate("document.activeElement.id") == "handle-b":
                break
        assert page.evaluate("document.activeElement.id") == "handle-b"
        label = page.locator("#handle-b").get_attribute("aria-label")
        assert "Hexagonal prism" in label
        help = page.locator("#handle-b").get_attribute("aria-describedby")
        assert "arrow keys" in page.locator(f"#{help}").text_content()
        state = [fields(page)]
        for key in ("ArrowDown", "Control+ArrowDown", "Shift+ArrowLeft", "Shift+PageUp"):
            page.focus("#handle-b")
            page.keyboard.press(key)
            check_against_library(page, server, shapes)
            state.append(fields(page))
        steps = [
            np.subtract(numbers(after["b.at"]), numbers(before["b.at"]))
            for before, after in itertools.pairwise(state)
        ]
        assert np.count_nonzero(steps[0]) == 1  # along one axis
        np.testing.assert_allclose(steps[1], steps[0] / 10, atol=2e-4)
        assert not steps[2].any()
        assert not steps[3].any()
        assert len({s["b.turn"] for s in state}) == 3


def test_a_link_is_the_scene(browser: Any, server: hullcast.Client):
    """A link restores the scene in another window: numbers, own points and camera."""
    shown = ["#alpha", "#separation", "#points data"]
    with opened(browser, server) as page:
        page.click("#paste-b")
        page.fill("#paste-text", "v 0 0 0\nv 0.7 0 0\nv 0 0.7 0\nv 0 0 0.7\nv .1 .1 .1\nf 1 2 3\n")
        page.click("#paste-use")
        page.select_option("#shape-a", "link")
        settled(page)
        drag(page, "b", (-40, 30))
        page.fill("#margin", "5")
        settled(page)
        there, first = link(page), [values(page, selector) for selector in shown]
        look = page.locator("#stage").screenshot()
    with opened(browser, server, there) as page:
        assert link(page) == there
        assert [values(page, selector) for selector in shown] == first
        assert len(first[2]) > 0
        assert page.locator("#shape-b option:checked").inner_text() == "Own points"
        check_against_library(page, server, [page.shapes[0], page.shapes[1]])
        page.locator("#shape-a").focus()  # as in the first window, so that no hull is marked
        assert len(page.locator("#stage").screenshot()) == pytest.approx(len(look), rel=0.2)


def test_what_is_wrong_is_said(browser: Any, server: hullcast.Client):
    with opened(browser, server, "#a=teapot") as page:
        assert "“a” cannot be read" in page.locator("#notice").inner_text()
    with opened(browser, server) as page:
        page.click("#paste-a")
        for text, words in [
            ("1 2", "line 1"),
            ("1 2 3", "at least 4"),
            ("[[1, 2, 3], [1, 2]]", "point 2"),
            ("{", "not JSON"),
        ]:
            page.fill("#paste-text", text)
            page.click("#paste-use")
            assert words in page.locator("#paste-error").inner_text()
        page.fill("#paste-text", "0 0 0\n1 0 0\n0 1 0\n1 1 0\n")
        page.click("#paste-use")
        settled(page)
        assert "COPLANAR" in page.locator("#error").inner_text()
        page.select_option("#shape-a", "box")
        settled(page)
        assert page.locator("#error").is_hidden()
        # A hull that was deleted in the meantime is registered again.
        with grpc.insecure_channel(server.target) as channel:
            call = channel.unary_unary(
                "/hullcast.v1.HullService/DeleteHulls",
                request_serializer=hulls_pb2.DeleteHullsRequest.SerializeToString,
                response_deserializer=hulls_pb2.DeleteHullsResponse.FromString,
            )
            solid = [points for points in page.shapes.values() if np.ptp(points, axis=0).min() > 0]
            # The page sends the planarity that this package sends by default, so the ids are equal.
            ids = [hull.id for hull in server.register(solid)]
            call(hulls_pb2.DeleteHullsRequest(ids=ids), timeout=60)
        drag(page, "b", (0, -20))
        assert page.locator("#error").is_hidden()
        check_against_library(page, server, list(page.shapes.values())[-2:])


def test_a_server_with_tokens_and_one_that_is_gone(browser: Any, tmp_path: Path):
    tokens = tmp_path / "tokens"
    tokens.write_text("open-sesame\n")
    arguments = ["--playground", "--register-tokens", str(tokens)]
    with browser.new_context() as context:
        page = context.new_page()
        with hullcast.serve(arguments=arguments) as server:
            page.goto(f"http://{server.target}/")
            settled(page)
            assert "token" in page.locator("#error").inner_text()
            page.fill("#token", "open-sesame")
            page.keyboard.press("Enter")
            page.wait_for_selector("#alpha[value]")
            assert page.locator("#error").is_hidden()
            assert page.locator("#token-form").is_hidden()
        page.focus("#handle-b")
        page.keyboard.press("ArrowUp")
        page.wait_for_selector("#error:not([hidden])")
        assert "cannot be reached" in page.locator("#error").inner_text()


CALL = """async address => {
    const headers = {"content-type": "application/grpc-web+proto", "x-grpc-web": "1"};
    const path = "/hullcast.v1.ServerService/GetServerInfo";
    try {
        const answer = await fetch(address + path, {method: "POST", headers, body: new Uint8Array(5)});
        const bytes = new Uint8Array(await answer.arrayBuffer());
        return [answer.headers.get("content-type"), Array.from(bytes)];
    } catch (error) {
        return error.name;
    }
}"""


def test_pages_of_other_sites_call_if_their_origin_is_listed(browser: Any):
    """Catches a preflight answer that Chromium does not accept, and a page that may call unlisted."""
    sites = [HTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) for _ in range(2)]
    origins = [f"http://127.0.0.1:{site.server_port}" for site in sites]
    for site in sites:
        Thread(target=site.serve_forever, daemon=True).start()
    arguments = ["--grpc-web", "--grpc-web-origins", origins[0]]
    with hullcast.serve(arguments=arguments) as server, browser.new_context() as context:
        answers = []
        for origin in origins:
            page = context.new_page()
            page.goto(origin)  # The page is an error message, but of this origin.
            answers.append(page.evaluate(CALL, f"http://{server.target}"))
    for site in sites:
        site.shutdown()
        site.server_close()
    (kind, body), refused = answers
    assert kind == "application/grpc-web+proto"
    length = int.from_bytes(bytes(body[1:5]), "big")
    info = server_pb2.GetServerInfoResponse.FromString(bytes(body[5 : 5 + length]))
    assert body[0] == 0
    assert info.contract >= 1
    assert b"grpc-status:0" in bytes(body[5 + length :])
    assert refused == "TypeError"


def test_a_phone(browser: Any, server: hullcast.Client):
    """Nothing is wider than the screen, targets fit fingers, and a finger can drag."""
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
    with opened(browser, server, device_scale_factor=2, **phone) as page:
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        sections = [page.locator(s).bounding_box() for s in (".stage", ".controls", ".numbers")]
        assert all(box["width"] > 360 for box in sections)
        assert [box["y"] for box in sections] == sorted(box["y"] for box in sections)
        for selector in (".handle", ".modes span", "select", "header button"):
            assert page.locator(selector).first.bounding_box()["height"] >= 32
        before = fields(page)
        session = page.context.new_cdp_session(page)
        x, y = place(page, "b")

        def touch(kind: str, *points: tuple[float, float]) -> None:
            touches = [{"x": x, "y": y} for x, y in points]
            session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})

        touch("touchStart", (x, y))
        for step in range(1, 9):
            touch("touchMove", (x, y + 5 * step))
        touch("touchEnd")
        settled(page)
        assert fields(page)["b.at"] != before["b.at"]
        assert fields(page)["view"] == before["view"]
        check_against_library(page, server, [page.shapes[0], page.shapes[1]])


@pytest.mark.parametrize("size", [(390, 844), (320, 568), (844, 390)])
def test_phones_of_every_size(browser: Any, server: hullcast.Client, size: tuple[int, int]):
    """The overlays are entirely inside the picture, and no target is too small for a finger."""
    width, height = size
    phone = {"viewport": {"width": width, "height": height}, "has_touch": True, "is_mobile": True}
    with opened(browser, server, **phone) as page:
        assert page.evaluate("document.documentElement.scrollWidth") == width
        frame = page.locator("#stage").bounding_box()
        assert frame["height"] <= height * 0.8
        overlay = page.locator(".handles > *, .modes span")
        boxes = [overlay.nth(i).bounding_box() for i in range(overlay.count())]
        assert len(boxes) == 6
        for box in boxes:
            assert box["x"] >= frame["x"]
            assert box["x"] + box["width"] <= frame["x"] + frame["width"]
        handle = page.locator("#handle-a").bounding_box()
        assert handle["width"] == handle["height"]
        targets = page.locator("select, main button, input[type=range], .toggles label, summary")
        targets = targets.filter(visible=True)
        heights = [targets.nth(i).bounding_box()["height"] for i in range(targets.count())]
        assert len(heights) > 12
        assert min(heights) >= 40


def test_dark_is_another_look(browser: Any, server: hullcast.Client):
    """The pictures follow the colour scheme, even if it changes while the page is open."""
    with opened(browser, server, color_scheme="light") as page:
        light = [page.locator(figure).screenshot() for figure in ("#stage", "#gauss", "#plane")]
        page.emulate_media(color_scheme="dark")
        page.wait_for_timeout(300)
        dark = [page.locator(figure).screenshot() for figure in ("#stage", "#gauss", "#plane")]
        assert all(one != other for one, other in zip(light, dark, strict=True))


@pytest.mark.skipif(shutil.which("npm") is None, reason="npm is not installed")
def test_the_bundle_is_what_its_sources_make(tmp_path: Path):
    """Catches a change of the sources that was committed without its bundle."""
    playground = ROOT / "playground"
    # Build in a copy, because a build leaves files beside the sources.
    here = tmp_path / "playground"
    ignored = shutil.ignore_patterns("node_modules", "generated", "dist")
    shutil.copytree(playground, here, ignore=ignored)
    for beside in ("proto", "examples"):
        (tmp_path / beside).symlink_to(ROOT / beside)
    environment = os.environ | {"PROTOC": f"{sys.executable} -m grpc_tools.protoc"}
    for command in (["npm", "ci", "--silent"], ["npm", "run", "--silent", "build"]):
        subprocess.run(command, cwd=here, env=environment, check=True, timeout=600)
    built = here / "dist"
    names = sorted(file.name for file in built.iterdir())
    assert names == sorted(file.name for file in (playground / "dist").iterdir())
    _, different, missing = filecmp.cmpfiles(built, playground / "dist", names, shallow=False)
    assert (different, missing) == ([], [])
