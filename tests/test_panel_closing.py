"""Panels that are closed, by hand or by a rerun of their cell: nothing of them is left, and others go on."""

import asyncio
import gc
import time
import weakref
from types import SimpleNamespace

import comm
import ipywidgets as widgets
import numpy as np
import pytest
from IPython.core.events import EventManager

from tests.performances import performance
from tests.scenes import turning_clip
from workbench.config import preset
from workbench.diagnosis import Change, Diagnosis, Reason, Uncertainty
from workbench.frames import read_picture
from workbench.landmarks.files import read_landmark_file
from workbench.samples import sample
from workbench.session import TuningSession, material_of_photo
from workbench.widgets import (
    AvatarPlayer,
    FitPlayground,
    LightPanel,
    LivePanel,
    PlainPanel,
    SessionOpener,
    TuningPanel,
    cell_reruns,
    make_head_view,
)
from workbench.widgets.closing import refill

LONGEST_S = 60.0


@pytest.fixture(scope="module")
def photo():
    landmarks = next(iter(read_landmark_file(sample("astronaut-landmarks")))).landmarks
    return material_of_photo(read_picture(sample("astronaut")), landmarks, "astronaut")


@pytest.fixture
def others():
    """What is open already."""
    return open_now()


def open_now():
    """The widgets and connections that are open, by their numbers."""
    gc.collect()
    return set(widgets.widgets.widget._instances), set(comm.get_comm_manager().comms)


def is_gone(*references):
    """Whether nothing refers to these objects; a thread may hold them a little longer, until its work is cancelled."""
    deadline = time.monotonic() + LONGEST_S
    while any(reference() is not None for reference in references) and time.monotonic() < deadline:
        gc.collect()
        time.sleep(0.05)
    return all(reference() is None for reference in references)


def use(panel):
    """Do what makes parts of a panel later."""
    panel.tabs.selected_index = list(panel.tabs.titles).index("Compare")
    panel.controls.search.value = "no such setting"
    panel.session.take_snapshot("before")
    for name in ("face-it", "joint"):
        panel.session.use(preset(name))
    names, none = ("yaw", "pitch", "roll", "x", "y", "z", "jawOpen"), np.zeros(3)
    uncertainty = Uncertainty(
        names, np.eye(7), np.eye(7), 1.0, none, none, np.zeros(1), np.zeros(1, bool), condition=1.0, pairs=()
    )
    mute = Change("Mute the jaw", config={"landmarks": {"weights": {"jaw": 0.0}}})
    reason = Reason("jaw", "The jaw is off", "by 9 %", 0.9, {}, mute, before_percent=3.0, after_percent=1.0)
    for _ in range(2):
        panel.diagnosis.show(0, Diagnosis((reason,), (), uncertainty, panel.fit))
    panel.overlay.view.webgl = False  # its place is taken by pictures
    assert panel.wait_idle(300)


@pytest.mark.parametrize("of", ["photo", pytest.param("clip", marks=pytest.mark.long)])
def test_nothing_of_a_closed_panel_is_left(head, photo, of, others):
    session = TuningSession(head, photo if of == "photo" else turning_clip(head, 3, -8.0))
    panel = TuningPanel(session, backend="webgl")
    assert panel.wait_idle(550)
    use(panel)
    assert len(open_now()[0] - others[0]) > 1600
    panel.close()
    panel.close()
    panel, session = weakref.ref(panel), weakref.ref(session)
    assert is_gone(panel, session)
    assert open_now() == others


def test_another_panel_of_the_session_goes_on(head, photo, others):
    session = TuningSession(head, photo)
    kept = PlainPanel(session)
    assert kept.wait_idle(300)
    of_kept = open_now()[0] - others[0]
    closed = TuningPanel(session, backend="webgl")
    assert closed.wait_idle(550)
    closed.close()
    assert of_kept <= open_now()[0]
    kept.controls.by_path["weights.tau"].turn(5.0)
    assert kept.wait_idle(60)
    assert session.config.weights.tau == 5.0
    assert kept.history.undo.disabled is False
    kept.close()
    assert open_now() == others


def test_what_a_user_shows_beside_a_panel_stays(head, photo, others):
    panel, beside = PlainPanel(TuningSession(head, photo)), widgets.HTML("mine")
    both = widgets.HBox([panel, beside])
    panel.close()
    assert {one.comm is None for one in (both, beside)} == {False}
    for one in (both, both.layout, beside, beside.layout, beside.style):
        one.close()
    del panel, both
    assert open_now() == others


KINDS = {
    "live": lambda head, photo: LivePanel(sample("performance"), head),
    "plain": lambda head, photo: PlainPanel(TuningSession(head, photo)),
    "playground": lambda head, photo: FitPlayground(photo.pictures[0], photo.observations[0].landmarks, head),
    "player": lambda head, photo: AvatarPlayer(performance(head), head, backend="webgl"),
    "light": lambda head, photo: LightPanel(lambda light: np.zeros((8, 8, 3))),
    "opener": lambda head, photo: SessionOpener(),
    "tuning": lambda head, photo: TuningPanel(TuningSession(head, photo), backend="webgl"),
    "head": lambda head, photo: make_head_view(head, (64, 64), "webgl"),
    "pictures": lambda head, photo: make_head_view(head, (64, 64), "pictures"),
}
PANELS = list(KINDS)[:7]


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_of_other_closed_panels_is_left(head, photo, kind, others):
    panel = KINDS[kind](head, photo)
    assert open_now() != others
    if kind == "plain":
        assert panel.wait_idle(300)
    panel.close()
    assert open_now() == others
    panel = weakref.ref(panel)
    assert is_gone(panel)


def test_an_opener_closes_its_panel(photo, head, others):
    opener = SessionOpener(PlainPanel)
    opener.open_sample("sample portrait")
    assert opener.wait_idle(300)
    opener.close()
    assert open_now() == others


def test_a_refilled_box_closes_what_was_in_it(others):
    box, first, second = widgets.VBox(), widgets.HBox([widgets.Button()]), widgets.HTML()
    refill(box, [first])
    refill(box, [second])
    assert (first.comm, first.children[0].comm, first.layout.comm) == (None, None, None)
    assert second.comm is not None
    for one in (box, box.layout, second, second.layout, second.style):
        one.close()
    assert open_now() == others


# --- a rerun of a cell ---


class Panel(widgets.VBox):
    """Stands in for a panel."""

    def __init__(self) -> None:
        super().__init__()
        cell_reruns.replace_earlier(self)


@pytest.fixture
def run(monkeypatch):
    """Runs a function as a cell; stands in for a kernel and the message that asked for it."""

    def run(cell, number, made, kind="execute_request"):
        message = {"header": {"msg_type": kind, "msg_id": f"message {number}"}, "metadata": cell and {"cellId": cell}}
        monkeypatch.setattr(cell_reruns, "_message", lambda: message)

        async def handle():
            return made()

        return asyncio.run(handle())

    return run


def is_closed(panel, within_s=LONGEST_S):
    deadline = time.monotonic() + within_s
    while panel.comm is not None and time.monotonic() < deadline:
        time.sleep(0.01)
    return panel.comm is None


def test_a_rerun_of_a_cell_closes_the_panels_of_its_earlier_run_alone(run):
    first, second = run("cell", 1, lambda: (Panel(), Panel()))
    neighbour = run("another cell", 2, Panel)
    assert not is_closed(first, 0.1)
    again = run("cell", 3, Panel)
    assert is_closed(first)
    assert is_closed(second)
    last = run("cell", 4, Panel)
    assert is_closed(again)
    assert not is_closed(neighbour, 0.1)
    assert not is_closed(last, 0.1)


def test_what_a_cell_makes_that_is_not_known_stays(run):
    nameless, once_more = run({}, 1, Panel), run({}, 2, Panel)
    of_cell, of_button = run("cell", 3, Panel), run("cell", 4, Panel, kind="comm_msg")
    outside = Panel()  # in no kernel's thread, though a message of the cell is the last
    assert not any(is_closed(panel, 0.05) for panel in (nameless, once_more, of_cell, of_button, outside))


def test_panels_that_a_variable_holds_stay(run, monkeypatch):
    """By itself, or in a list; IPython keeps outputs in variables of its own, which do not count."""
    alone, listed, forgotten = run("keeping cell", 1, lambda: (Panel(), Panel(), Panel()))
    variables = {"alone": alone, "others": [listed], "_1": forgotten, "Out": {1: forgotten}}
    shell = SimpleNamespace(
        user_ns=variables, user_ns_hidden={"Out"}, events=EventManager(None, {"post_execute": None})
    )
    monkeypatch.setattr(cell_reruns, "_shell", lambda: shell)
    run("keeping cell", 2, Panel)
    assert not is_closed(forgotten, 0.1)  # the cell still runs
    shell.events.trigger("post_execute")
    assert is_closed(forgotten)
    assert not is_closed(alone, 0.1)
    assert not is_closed(listed, 0.1)
    variables["alone"] = None
    run("keeping cell", 3, Panel)
    shell.events.trigger("post_execute")
    assert is_closed(alone)


def test_a_panel_that_nobody_has_is_not_kept_for_its_rerun(run):
    made = run("cell", 1, Panel)
    made.close()
    made = weakref.ref(made)
    assert is_gone(made)


@pytest.mark.parametrize("kind", PANELS)
def test_a_rerun_replaces_every_kind_of_panel(head, photo, kind, run, others):
    first, second = (run("cell", number, lambda: KINDS[kind](head, photo)) for number in (1, 2))
    assert is_closed(first)
    assert second.comm is not None
    second.close()
    del first, second
    deadline = time.monotonic() + LONGEST_S
    while open_now() != others and time.monotonic() < deadline:  # its box is closed first
        time.sleep(0.01)
    assert open_now() == others
