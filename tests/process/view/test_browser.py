"""What is seen in a browser: a run from a file, from a server, and live; the arms stand where the log has them."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from agent.host.ready_line import values_of
from agent.log.read import RunLog, open_log, read_log
from agent.report.prepared import prepare
from agent.telemetry.link.endpoint import FREE_PORT
from agent.telemetry.link.session import Network, open_session
from agent.telemetry.row.topics import Address, Kind
from agent.view.camera import Camera
from agent.view.draw import project
from agent.view.motion import motion_now
from agent.view.scene import OBJECT, OBJECT_COLOUR
from agent.view.staged import Staged, stage
from tests.support.chromium import Page, Pixels, chromium
from tests.support.command import coop
from tests.support.coop import PAPER, ready, start
from tests.support.ports import free_port

pytest.importorskip("viser", reason="the extra `view` is not installed")

from agent.view.browser import PAGE_PX
from agent.view.live import FORCE_N, _start

SIZE = (1280, 720)
BAR_PX = 40  # the controls of a file take so much of the height
PANEL_PX = 388  # the controls of a server take so much of the width
PATCH_PX = 5


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with chromium(tmp_path_factory.mktemp("browser"), SIZE) as found:
        yield found


@pytest.fixture
def page(browser: Page) -> Page:
    """The tab, with nothing in it and no request of an earlier page."""
    browser.open("about:blank")
    assert not np.ptp(browser.wait(lambda seen: seen.max() > 0 and not np.ptp(seen)))
    browser.requests.clear()
    return browser


@cache
def staged(log: Path) -> Staged:
    with open_log(log) as opened:
        return stage(prepare(opened), 20.0)


def hue(colour: object) -> Pixels:
    shade = np.asarray(colour, float) + 1e-9
    return np.asarray(shade / np.linalg.norm(shade, axis=-1, keepdims=True))


def stands(seen: Pixels, place: Pixels, colour: object, near: float = 0.25) -> bool:
    """Whether most of the pixels about a place have the hue of a colour."""
    x, y = np.round(place).astype(int)
    around = seen[y - PATCH_PX : y + PATCH_PX + 1, x - PATCH_PX : x + PATCH_PX + 1].reshape(-1, 3)
    alike = np.abs(hue(around) - hue(colour)).max(axis=1) < near
    return bool(len(around) and alike.mean() > 0.5 and around.std() + np.ptp(around.mean(axis=0)) > 20.0)


def arms_at(shown: Staged, row: int, camera: Camera, size: tuple[int, int]) -> Callable[[Pixels], bool]:
    """Whether a picture has both arms and the object of an instant where they belong."""
    places = project(shown.scene, shown.placed, row, camera, size)
    left, right = (arm.colour for arm in shown.scene.cell.arms)
    wanted = {"left/base": left, "left/shoulder": left, "right/base": right, "right/shoulder": right}
    return lambda seen: all(
        [stands(seen, places[f"arms/{name}"], colour) for name, colour in wanted.items()]
        + [stands(seen, places[OBJECT], OBJECT_COLOUR)]
    )


def test_a_file_opens_from_the_disk_without_a_request(
    page: Page, paper_runs: tuple[Path, Path], tmp_path: Path
) -> None:
    log, html = paper_runs[0] / "run.mcap", tmp_path / "view.html"
    done = coop("view", log, "--html", html)
    assert done.code == 0, done.err
    size = (SIZE[0], SIZE[1] - BAR_PX)
    camera = staged(log).camera(size)
    page.open(html.as_uri())
    good = arms_at(staged(log), 40, camera, size)  # the object moves by less than a patch in three seconds
    seen = page.wait(good)
    assert good(seen)
    assert {request.partition(":")[0] for request in page.requests} <= {"file", "data", "blob"}


@pytest.mark.long  # page and pictures by themselves: tests/unit/view
def test_a_report_has_the_run_beside_it_and_a_film_is_made(paper_runs: tuple[Path, Path], tmp_path: Path) -> None:
    log = paper_runs[0] / "run.mcap"
    done = coop("report", log, "--out", tmp_path / "report", "--view")
    assert done.code == 0, done.err
    assert {"report.html", "start.png", "view.html"} <= {path.name for path in (tmp_path / "report").iterdir()}
    film = tmp_path / "film.gif"
    done = coop("view", log, "--film", film, "--from", 1, "--to", 2)
    assert done.code == 0, done.err
    assert done.out == f"film     {film}, 5 pictures\n"
    again = coop("view", log, "--film", film)
    assert again.code == 2
    assert "found one of that name" in again.err


@contextlib.contextmanager
def served(*arguments: str | Path, cwd: Path) -> Iterator[str]:
    """The address of a page, and a clean end."""
    process = start("view", *arguments, "--no-browser", "--port", free_port(), cwd=cwd)
    try:
        yield values_of(ready(process))["page"]
        process.send_signal(signal.SIGTERM)
        output, errors = process.communicate(timeout=30.0)
        assert process.returncode == 0, errors
        assert "pictures shown" in errors
        assert output == ""
    finally:
        process.kill()
        process.wait()


CLICK = """[...document.querySelectorAll("button")].find(b => b.textContent.trim() === "%s")?.click()"""


def test_a_page_shows_the_start_and_plays(page: Page, paper_runs: tuple[Path, Path], tmp_path: Path) -> None:
    log = paper_runs[0] / "run.mcap"
    size = (SIZE[0] - PANEL_PX, SIZE[1])
    camera = staged(log).camera((880, 720))
    with served(log, cwd=tmp_path) as address:
        page.open(address)
        good = arms_at(staged(log), 0, camera, size)
        assert good(page.wait(good))
        said = page.run("document.body.innerText")
        assert "t = 0.0 s · TRACK" in said
        assert "arms disagree on the object by [mm]" in said
        assert "share" not in said.lower()
        page.run(CLICK % "Play")
        page.wait(lambda _: "t = 3.0 s" in page.run("document.body.innerText"))
        assert "t = 3.0 s" in page.run("document.body.innerText")
        assert {request.split("/")[2] for request in page.requests if request.startswith("http")} <= {
            address.removeprefix("http://")
        }


def test_a_live_page_shows_the_newest_rows(page: Page, paper_runs: tuple[Path, Path], tmp_path: Path) -> None:
    log = read_log(paper_runs[0] / "run.mcap")
    size = (SIZE[0] - PANEL_PX, SIZE[1])
    with open_session(Network(listen=FREE_PORT)) as opened:
        assert opened.endpoint is not None
        with served(PAPER, "--live", "--connect", opened.endpoint, cwd=tmp_path) as address:
            page.open(address)
            shown = live_stage(log)
            good = arms_at(shown, 0, live_camera(shown), size)

            def tell(seen: Pixels) -> bool:
                for member in ("left", "right"):
                    rows = log.agents[member][-3:]
                    opened.session.put(Address("paper", member, Kind.STATE).key, rows.tobytes())
                assert log.plant is not None
                opened.session.put(Address("paper", "plant", Kind.STATE).key, log.plant[-1:].tobytes())
                return good(seen) and "TRACK" in page.run("document.body.innerText")

            assert good(page.wait(tell))
            assert f"t = {log.agents['left']['t'][-1]:.1f} s · TRACK" in page.run("document.body.innerText")


def live_stage(log: RunLog) -> Staged:
    from agent.config.files import load_files
    from agent.view.drawing import drawing_of_cell
    from agent.view.scene import Scene

    motion = motion_now({name: rows[-1:] for name, rows in log.agents.items()}, log.plant[-1:])  # type: ignore[index]
    assert motion is not None
    scene = Scene(drawing_of_cell(load_files(PAPER)), force_N=FORCE_N, internal_N=FORCE_N)
    return Staged(scene, motion, scene.place(motion))


def live_camera(shown: Staged) -> Camera:
    from agent.config.files import load_files
    from agent.view.camera import camera_for

    before = shown.scene.place(_start(load_files(PAPER)))
    return camera_for(shown.scene, shown.scene.points(before, 0), PAGE_PX[0] / PAGE_PX[1])
