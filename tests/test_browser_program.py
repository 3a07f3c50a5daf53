"""The JavaScript of the widgets: modules become one program, no function is long, and what the pure ones compute."""

import json
import re
from collections import Counter

import cv2
import numpy as np
import pytest

from tests.javascript import asked_of_node, functions, needs_node
from workbench.errors import InputError
from workbench.face import load_character
from workbench.geometry import project
from workbench.landmarks.alignment import MEAN_SHAPE
from workbench.landmarks.scheme import error_unit
from workbench.pictures.mesh import face_normals, to_camera
from workbench.widgets.browser_program import BROWSER, browser_program
from workbench.widgets.head_mesh import collar
from workbench.widgets.panel_page import ACTIONS
from workbench.widgets.viewpoint import front_viewpoint, orbited, panned, zoomed
from workbench.widgets.webgl_head_view import viewpoint_numbers

MODULES = sorted(BROWSER.rglob("*.js"))
PROGRAMS = sorted(str(path.relative_to(BROWSER)) for path in MODULES if "\nexport default" in path.read_text("utf-8"))
LONGEST_FUNCTION = 80


def write(folder, **modules: str) -> None:
    for name, text in modules.items():
        (folder / f"{name}.js").write_text(text, encoding="utf-8")


HEARS = """(() => {
  class Base {
    heard = []; asked = []; listeners = {}; worn = new Set();
    classList = { add: (...names) => names.forEach((name) => this.worn.add(name)) };
    views = { only: Promise.resolve({ el: { classList: this.classList } }) };
    get() { return ["fw-grow"]; }
    comm = { on_msg: (handle) => { this.hear = handle; }, send: (data) => this.asked.push(data.method) };
    async _handle_comm_msg(message) { if (message.content.data.method === "update") this.heard.push(message); }
    on(name, callback) { this.listeners[name] = callback; }
    off(name) { delete this.listeners[name]; }
    set(name) { this.listeners[`change:${name}`]?.(this); }
  }
  class GivenUp extends Base {
    async _handle_comm_msg(message) { await this.ready; return super._handle_comm_msg(message); }
  }
  return async (ready, missed) => {
    const real = new GivenUp();
    real.ready = ready;
    real.hear = (message) => real._handle_comm_msg(message).catch(() => {});
    const model = Object.fromEntries(["on", "off", "set"].map((name) => [name, real[name].bind(real)]));
    keepHearing({ model }, () => real.asked.push("missed"));
    await new Promise((done) => setTimeout(done));
    await real.hear({ content: { data: { method: "update" } } });
    return [real.heard.length, real.asked, Object.keys(real.listeners), [...real.worn]];
  };
})()"""
"""What a model hears, and what it asks the kernel for, with a library that waits for `ready` before each message."""


class TestHearing:
    @needs_node
    @pytest.mark.parametrize(
        ("ready", "asked", "worn"),
        [("Promise.resolve()", [], []), ("Promise.reject()", ["request_state", "missed"], ["fw-grow"])],
    )
    def test_a_model_that_the_library_gave_up_hears_and_asks_for_what_it_missed(self, ready, asked, worn):
        hearing = BROWSER / "shared" / "hearing.js"
        assert asked_of_node(hearing, "keepHearing", f"await {HEARS}({ready})") == [1, asked, [], worn]

    @pytest.mark.parametrize("program", PROGRAMS)
    def test_every_program_keeps_its_model_hearing(self, program):
        assert "keepHearing" in (BROWSER / program).read_text("utf-8").split("export default")[1]


CARRIED = """(async () => {
  const heard = [], head = { set_state: (state) => heard.push(state) };
  const get_model = (id) => (id === "head" ? Promise.resolve(head) : Promise.reject(new Error("closed")));
  const on = (name, callback) => { listeners[name] = callback; }, listeners = {};
  let carried;
  handOn({ on, get: () => carried, widget_manager: { get_model } });
  const toHead = (state) => ({ to: "head", state }), gone = { to: "gone", state: { x: 2 } };
  for (carried of [{}, toHead({ x: 1 }), gone, toHead({ y: 3 })]) await listeners["change:_carried"]();
  return heard;
})()"""
"""What a head is given by the widget that carries its changes."""


class TestCarrying:
    @needs_node
    def test_what_a_message_carries_is_handed_on_where_the_other_widget_is_there(self):
        carrying = BROWSER / "shared" / "carrying.js"
        assert asked_of_node(carrying, "handOn", f"await {CARRIED}") == [{"x": 1}, {"y": 3}]


class TestJoining:
    @needs_node
    def test_a_program_computes_what_its_modules_compute(self, tmp_path):
        (tmp_path / "package.json").write_text('{ "type": "module" }')
        write(
            tmp_path,
            numbers="export const ONE = 1, TWO = 2; // two names\nconst hidden = 40;\n"
            "export const more = () => hidden;\n",
            sums='import { ONE, TWO } from "./numbers.js";\nconst hidden = 0.5;\n'
            "export function sum() {\n  return ONE + TWO + hidden;\n}\nexport class Sums {}\n",
            view='import {\n  more, TWO,\n} from "./numbers.js";\nimport { Sums, sum } from "./sums.js";\n'
            "const hidden = 100;\nexport default [more() + TWO + sum() + hidden, new Sums() instanceof Sums];\n",
        )
        (tmp_path / "joined.js").write_text(browser_program("view.js", tmp_path), encoding="utf-8")
        apart = asked_of_node(tmp_path / "view.js", "default as value", "value")
        assert asked_of_node(tmp_path / "joined.js", "default as value", "value") == apart == [145.5, True]

    def test_a_module_that_two_others_need_stands_once_and_first(self, tmp_path):
        write(
            tmp_path,
            shared="export const ONE = 1;\n",
            left='import { ONE } from "./shared.js";\nexport const left = ONE;\n',
            right='import { ONE } from "./shared.js";\nimport { left } from "./left.js";\nexport const right = ONE;\n',
            view='import { right } from "./right.js";\nimport { left } from "./left.js";\n'
            "export default { left, right };\n",
        )
        program = browser_program("view.js", tmp_path)
        assert re.findall(r"^const (\$\w+) = \(", program, re.MULTILINE) == ["$shared", "$left", "$right"]
        assert "import " not in program

    def test_modules_in_a_circle_are_refused(self, tmp_path):
        write(
            tmp_path,
            view='import { other } from "./other.js";\nexport default other;\n',
            other='import { third } from "./third.js";\nexport const other = third;\n',
            third='import { other } from "./other.js";\nexport const third = other;\n',
        )
        with pytest.raises(InputError, match=r"other\.js and third\.js import each other in a circle"):
            browser_program("view.js", tmp_path)

    @pytest.mark.parametrize(
        "line",
        ['import * as all from "./a.js";', 'import { a } from "https://x.org/a.js";', "export let a = 1;",
         "export { a };", 'export * from "./a.js";'],
    )  # fmt: skip
    def test_other_imports_and_exports_are_refused(self, tmp_path, line):
        write(tmp_path, view=f"{line}\nexport default 1;\n")
        with pytest.raises(InputError, match=re.escape(line)):
            browser_program("view.js", tmp_path)


@needs_node
@pytest.mark.parametrize("name", PROGRAMS)
def test_every_program_loads_and_exports_a_widget(name, tmp_path):
    (tmp_path / "program.mjs").write_text(browser_program(name), encoding="utf-8")
    assert asked_of_node(tmp_path / "program.mjs", "default as widget", "typeof widget") in ("object", "function")


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(BROWSER)))
def test_no_function_is_long(path):
    long = {line: count for line, count in functions(path.read_text("utf-8")) if count > LONGEST_FUNCTION}
    assert not long, f"{path.name}: take apart the functions at these lines, with so many lines each: {long}"


def test_functions_are_found_and_measured():
    source = """function one(a = { b: 1 }) {
  if (a) { a(); } // {
  const two = (text) => {
    return `}` + "{" + text.replace(/[{]/g, "");
  };
}
const object = { three() {
  for (const x of []) {
  }
} };
class Four { }
"""
    assert sorted(functions(source)) == [(1, 6), (3, 3), (7, 4)]


def test_no_helper_stands_in_two_modules():
    whole = re.compile(
        r"^(?:export )?((?:async )?function .*?^\}|const \w+ = \([^\n]*|const \w+ = \[.*?\];)$", re.M | re.S
    )
    helpers = [text for path in MODULES for text in whole.findall(path.read_text("utf-8"))]
    assert helpers
    assert [text for text, count in Counter(helpers).items() if count > 1] == []


@needs_node
class TestChart:
    TICKS, SCALE, KEYS = (BROWSER / "chart" / name for name in ("ticks.js", "scale.js", "keys.js"))

    def test_ticks_are_round_numbers_within_the_range(self):
        assert asked_of_node(self.TICKS, "linearTicks", "linearTicks(0.3, 9.9, 5)") == [2, 4, 6, 8]
        assert asked_of_node(self.TICKS, "linearTicks", "linearTicks(-1, 1, 4)") == [-1, -0.5, 0, 0.5, 1]

    def test_ticks_of_a_logarithmic_axis_are_powers_and_in_a_short_one_their_parts(self):
        assert asked_of_node(self.TICKS, "logTicks", "logTicks(-2.5, 3.5, 8)") == [-2, -1, 0, 1, 2, 3]
        assert asked_of_node(self.TICKS, "logTicks", "logTicks(-4, 4, 4)") == [-4, -2, 0, 2, 4]
        short = asked_of_node(self.TICKS, "logTicks", "logTicks(0, 1, 8)")
        assert np.allclose(np.power(10.0, short), [1, 2, 5, 10])

    def test_numbers_are_written_short(self):
        values = "[0, 0.25, -3, 123456, 1e-7, NaN].map(words)"
        assert asked_of_node(self.TICKS, "words", values) == ["0", "0.25", "−3", "1.2e5", "1e−7", "–"]

    def test_the_nearest_value_is_found(self):
        found = asked_of_node(self.SCALE, "nearest", "[-5, 1.4, 1.6, 7, 99].map((x) => nearest([0, 1, 2, 8], x))")
        assert found == [0, 1, 2, 3, 3]

    def test_places_of_a_scale_lead_back_to_their_values(self):
        make = "scaleOf(rangeOf([0, 5, 10], [[1, 3, NaN]], false), 100, 50, false)"
        ask = f"(s => [s.toX(0), s.toX(10), s.fromX(s.toX(2.5)), s.toY(3) < s.toY(1)])({make})"
        assert asked_of_node(self.SCALE, "scaleOf, rangeOf", ask) == [54, 154, 2.5, True]

    def test_zeros_lie_below_everything_else_on_a_logarithmic_axis(self):
        make = "scaleOf(rangeOf([0, 1, 2], [[100, 0, 0.1]], true), 100, 50, true)"
        ask = f"(s => [s.toY(0) === s.bottom, s.toY(0.1) < s.bottom, s.range.zeros])({make})"
        assert asked_of_node(self.SCALE, "scaleOf, rangeOf", ask) == [True, True, True]

    def test_a_double_click_on_the_legend_leaves_one_and_then_brings_all_back(self):
        ask = "[afterDouble([], 'a', ['a', 'b', 'c']), afterDouble(['b', 'c'], 'a', ['a', 'b', 'c'])]"
        assert asked_of_node(self.KEYS, "afterDouble", ask) == [["b", "c"], []]


@needs_node
class TestPainting:
    def seen(self, happened: str, soon: str = "false") -> object:
        """Which moments of a page's life painted; `hidden` takes what is painted out of the page."""
        page = """
            let frames = [], hidden = false, timers = [], tasks = [];
            globalThis.queueMicrotask = (run) => tasks.push(run);
            globalThis.requestAnimationFrame = (run) => frames.push(run);
            globalThis.cancelAnimationFrame = () => { frames = []; };
            globalThis.setTimeout = (run) => timers.push(run);
            globalThis.clearTimeout = () => { timers = []; };
            const all = (runs) => runs.splice(0).forEach((run) => run());
            const later = () => all(timers), frame = () => all(frames), handled = () => all(tasks);
        """
        page += f"const seen = [], painting = onDemand((all) => !hidden && Boolean(seen.push(all)), {soon});"
        path = BROWSER / "shared" / "painting.js"
        return asked_of_node(path, "onDemand", f"(() => {{ {page} {happened}; return seen; }})()")

    @needs_node
    def test_much_is_asked_for_and_painted_once_in_the_next_frame(self):
        assert self.seen("painting.ask(), painting.ask(true), frame(), frame(), painting.ask(), frame()") == [
            True,
            False,
        ]

    @needs_node
    def test_what_is_wanted_soon_is_painted_after_its_message_and_then_again_in_the_frame(self):
        message = "painting.ask(), painting.ask(), handled(), seen.push('message')"
        assert self.seen(f"{message}, frame()", "true") == [True, "message"]
        assert self.seen(f"{message}, {message}, {message}, frame(), frame()", "true") == [
            *(True, "message", "message", "message", False)
        ]
        assert self.seen(f"{message}, frame(), {message}", "true") == [True, "message", False, "message"]
        assert self.seen("painting.ask(), painting.stop(), handled(), frame()", "true") == []

    @needs_node
    def test_what_is_out_of_the_page_for_a_moment_is_painted_when_it_is_back(self):
        """As cells are when JupyterLab puts its list of cells into order."""
        gone = "painting.ask(true), hidden = true, frame(), hidden = false, seen.push('back')"
        assert self.seen(f"{gone}, frame(), later(), frame(), later(), frame()") == ["back", True]

    @needs_node
    def test_what_stays_away_is_not_asked_for_ever(self):
        asked = "hidden = true, painting.ask(true); for (let k = 0; k < 99; k++) frame(), later()"
        assert self.seen(f"{asked}; seen.push(timers.length, frames.length)") == [0, 0]
        assert self.seen("painting.ask(), painting.stop(), later(), frame()") == []


@needs_node
def test_the_unit_of_errors_is_that_of_the_kernel():
    """From the front, and squeezed as a profile is."""
    shapes = [100.0 * MEAN_SHAPE, 100.0 * MEAN_SHAPE * [0.1, 1.0]]
    ask = f"{json.dumps([shape.tolist() for shape in shapes])}.map((points) => errorUnit((i) => points[i]))"
    told = asked_of_node(BROWSER / "shared" / "faces.js", "errorUnit", ask)
    assert told == pytest.approx([error_unit(shape) for shape in shapes])


class TestTimeline:
    TRACK, SPAN = (BROWSER / "timeline" / name for name in ("track.js", "span.js"))

    def test_every_frame_is_in_a_pixel_column_and_every_column_has_one(self):
        many = asked_of_node(self.TRACK, "columnFrames", "[0, 1, 2].map((k) => columnFrames(k, 3, 0, 10, 10))")
        assert many == [[0, 3], [3, 6], [6, 10]]
        few = asked_of_node(self.TRACK, "columnFrames", "[0, 1, 2, 3].map((k) => columnFrames(k, 4, 0, 2, 2))")
        assert few == [[0, 1], [0, 1], [1, 2], [1, 2]]

    def test_next_and_previous_flagged_frame_go_around_the_ends(self):
        track = "{ count: 6, marks: [4, 5, 4, 4, 5, 4] }"
        ask = f"[[0, 1], [1, 1], [4, 1], [4, -1], [1, -1]].map(([from, step]) => nextFlagged({track}, from, step))"
        assert asked_of_node(self.TRACK, "nextFlagged", ask) == [1, 4, 1, 1, 4]
        none = "nextFlagged({ count: 3, marks: [4, 4, 4] }, 2, 1)"
        assert asked_of_node(self.TRACK, "nextFlagged", none) == 2

    def test_a_pixel_stands_for_the_worst_of_its_own_frames_or_a_flagged_one(self):
        ask = """[[1, 2, 3, 9, 9], [5, 2, 3, 9, 9]].map((largest) =>
            [4, 5].map((last) => worstOf({ count: 5, largest, marks: [4, 4, last, 4, 4] }, 0, 3)))"""
        assert asked_of_node(self.TRACK, "worstOf", ask) == [[2, 2], [0, 2]]

    def test_a_zoomed_part_stays_within_the_track_and_keeps_some_frames(self):
        ask = "[zoomed(-5, 20, 100), zoomed(90, 120, 100), zoomed(50, 51, 100), zoomed(0, 1, 3)]"
        found = asked_of_node(self.SPAN, "zoomed", ask)
        assert [(part["from"], part["to"]) for part in found] == [(0, 25), (70, 100), (50, 58), (0, 3)]

    def test_the_frame_under_the_mouse_stays_there_while_zooming(self):
        start, end = asked_of_node(self.SPAN, "zoomedAt", "zoomedAt({ from: 0, to: 100 }, 25, 0.5, 100)")
        assert (start, end) == (12.5, 62.5)


@needs_node
class TestOverlay:
    LANDMARKS, PLACES, TOOLS = (BROWSER / "overlay" / name for name in ("landmarks.js", "places.js", "tools.js"))
    READ = (
        "(() => { const landmarks = makeLandmarks(() => {});"
        " const rows = [[10, 10, 14, 10], [50, 10, NaN, NaN]].flatMap((row) => [...row, 3, 4, 1, 1]);"
        " landmarks.read(new Float32Array(rows).buffer); return landmarks; })()"
    )

    def test_the_nearest_shown_landmark_within_reach_is_hit(self):
        ask = f"""(landmarks => [[11, 10], [14, 11], [30, 10], [49, 16]].map((place) =>
            ["observed", "model"].map((name) => hit(landmarks, (x, y) => [x, y], place, {{ [name]: true }})))
        )({self.READ})"""
        found = asked_of_node(self.LANDMARKS, "makeLandmarks, hit", ask)
        assert found == [[0, 0], [0, 0], [-1, -1], [1, -1]]

    def test_a_moved_landmark_stands_where_it_was_put_until_it_comes_back(self):
        ask = f"""(landmarks => {{
            landmarks.hold(0, 20, 30);
            const held = landmarks.observed(0), others = [landmarks.observed(1), landmarks.detected(0)];
            landmarks.release(0);
            return [held, ...others, landmarks.observed(0)];
        }})({self.READ})"""
        found = asked_of_node(self.LANDMARKS, "makeLandmarks", ask)
        assert found == [[20, 30], [50, 10], [10, 10], [10, 10]]

    @pytest.mark.parametrize(("sent", "told"), [(0, []), (7, [["cancel", [3], 10, 20]])], ids=["before", "after"])
    def test_a_cancelled_drag_puts_back_what_python_has_moved(self, sent, told):
        ask = f"""(() => {{
            const told = [], landmarks = {{ release() {{}}, drop() {{}} }};
            const gesture = {{ kind: "drag", index: 3, held: [10, 20], sent: {sent} }};
            cancelGesture({{ gesture, landmarks, draw() {{}} }}, {{ event: (...event) => told.push(event) }});
            return told;
        }})()"""
        assert asked_of_node(self.TOOLS, "cancelGesture", ask) == told

    def test_a_lasso_holds_what_lies_inside_even_if_it_is_bent(self):
        bent = "[[0, 0], [10, 0], [10, 10], [5, 2], [0, 10]]"
        ask = f"[[2, 5], [5, 8], [8, 5], [11, 1]].map((place) => insidePolygon(place, {bent}))"
        assert asked_of_node(self.LANDMARKS, "insidePolygon", ask) == [True, False, True, False]

    def test_a_fitted_box_fills_the_stage_and_stands_in_its_middle(self):
        found = asked_of_node(self.PLACES, "fitted, wholeBox", "fitted(wholeBox([640, 480]), [1280, 1000])")
        assert found == {"scale": 2, "x": 1, "y": 21}

    def test_zooming_keeps_the_place_under_the_pointer_and_stops_at_the_ends(self):
        view = "Object.assign(makeView('whole'), { scale: 2, x: 10, y: 20 })"
        ask = f"""(view => {{
            const place = [110, 220], before = view.toPicture(...place);
            const far = [1e6, 1e-6].map((factor) => zoomedAt(view, place, factor, [640, 480], [640, 480]).scale);
            Object.assign(view, zoomedAt(view, place, 1.5, [640, 480], [640, 480]));
            return [before, view.toPicture(...place), view.scale, ...far];
        }})({view})"""
        found = asked_of_node(self.PLACES, "makeView, zoomedAt", ask)
        assert found == [[50, 100], [50, 100], 3, 60, 0.5]


@needs_node
class TestHead:
    VIEWPOINT, MOUSE = (BROWSER / "head" / name for name in ("viewpoint.js", "mouse.js"))
    RODS, MESH, GEOMETRY, SCENE, WORN = (
        BROWSER / "drawing" / f"{name}.js" for name in ("rods", "mesh", "geometry", "scene", "worn")
    )
    SIZE = (300, 240)

    @pytest.mark.parametrize(
        ("change", "expected"),
        [
            ({"turn": [40.0, -25.0]}, lambda start: orbited(start, np.pi * 40 / 240, -np.pi * 25 / 240)),
            ({"turn": [0.0, 115.0]}, lambda start: orbited(start, 0.0, np.pi * 115 / 240)),
            ({"pan": [12.0, -7.0]}, lambda start: panned(start, 12.0, -7.0)),
            ({"zoom": 0.8}, lambda start: zoomed(start, 0.8)),
            ({"zoom": 1e-6}, lambda start: zoomed(start, 1e-6)),
            ({"zoom": 1e6}, lambda start: zoomed(start, 1e6)),
            ({"zoom": 0.9, "pan": [3.0, 4.0]}, lambda start: panned(zoomed(start, 0.9), 3.0, 4.0)),
        ],
    )
    def test_the_browser_moves_the_head_as_the_kernel_does(self, head, change, expected):
        start = orbited(front_viewpoint(head, self.SIZE), 0.4, 0.2)
        ask = f"numbersOf(moved(viewpointOf({viewpoint_numbers(start)}), {json.dumps(change)}, null, 240))"
        found = asked_of_node(self.VIEWPOINT, "moved, viewpointOf, numbersOf", ask)
        np.testing.assert_allclose(found, viewpoint_numbers(expected(start)), atol=1e-9)

    def test_a_reset_leads_to_the_front(self, head):
        front = viewpoint_numbers(front_viewpoint(head, self.SIZE))
        turned = viewpoint_numbers(orbited(front_viewpoint(head, self.SIZE), 0.4, 0.2))
        ask = f"numbersOf(moved(viewpointOf({turned}), {{ reset: true }}, viewpointOf({front}), 240))"
        np.testing.assert_allclose(
            asked_of_node(self.VIEWPOINT, "moved, viewpointOf, numbersOf", ask), front, atol=1e-9
        )

    def test_points_are_drawn_in_the_pixels_of_the_camera(self, head):
        viewpoint, width, height = orbited(front_viewpoint(head, self.SIZE), 0.4, 0.2), *self.SIZE
        pose = asked_of_node(
            self.VIEWPOINT,
            "poseOf, viewpointOf",
            f"poseOf(viewpointOf({viewpoint_numbers(viewpoint)}), {[*self.SIZE]})",
        )
        ask = f"[...projectionOf({pose['camera']}, {pose['size']}, [1, 1])]"
        matrix = np.reshape(asked_of_node(self.GEOMETRY, "projectionOf", ask), (4, 4)).T
        seen = head.neutral @ np.reshape(pose["turn"], (3, 3)).T + pose["shift"]
        clip = np.column_stack([seen, np.ones(len(seen))]) @ matrix.T
        places = (clip[:, :2] / clip[:, 3:] * [1, -1] + 1) / 2 * [width, height] - 0.5
        expected = project(viewpoint.camera, to_camera(head.neutral, *viewpoint.pose))
        np.testing.assert_allclose(places, expected, atol=1e-3)
        assert (np.abs(clip[:, 2]) < clip[:, 3]).all()

    def test_the_inside_of_the_neck_is_drawn_only_for_a_look_from_below_its_cut(self, head):
        looks = [orbited(front_viewpoint(head, self.SIZE), 0.0, pitch) for pitch in (0.0, 0.5, -0.5, -1.0)]
        poses = [
            {
                "turn": cv2.Rodrigues(look.pose[0])[0].ravel().tolist(),
                "shift": look.pose[1].tolist(),
                "pivot": [0, 0, 0],
            }
            for look in looks
        ]
        plane = collar(head).tolist()
        found = asked_of_node(self.SCENE, "seesInside", f"{json.dumps(poses)}.map((pose) => seesInside({plane}, pose))")
        assert found == [look.position @ plane[:3] > plane[3] for look in looks] == [False, False, True, True]
        assert not asked_of_node(self.SCENE, "seesInside", f"seesInside(null, {json.dumps(poses[3])})")

    def test_one_finger_has_a_place_and_two_a_middle_and_a_distance(self):
        found = asked_of_node(self.MOUSE, "spanOf", "[spanOf([{x: 1, y: 2}]), spanOf([{x: 1, y: 2}, {x: 7, y: 10}])]")
        assert found == [{"x": 1, "y": 2, "length": 0}, {"x": 4, "y": 6, "length": 10}]

    def test_the_keys_of_plus_and_minus_zoom_the_head_with_and_without_shift(self):
        """And leave none to the panel, which would weigh landmarks."""
        page = """
            const canvas = new EventTarget(), zooms = [], left = [];
            listenTo(canvas, () => 1, ({ zoom }) => zooms.push(zoom));
            for (const key of ["+", "=", "-", "_"]) {
              const event = Object.assign(new Event("keydown", { cancelable: true }), { key });
              if (canvas.dispatchEvent(event)) left.push(key);
            }
        """
        zooms, left = asked_of_node(self.MOUSE, "listenTo", f"(() => {{ {page} return [zooms, left]; }})()")
        assert (zooms, left) == (pytest.approx([0.9, 0.9, 1 / 0.9, 1 / 0.9]), [])

    def test_normals_point_outwards_and_a_seam_s_points_share_their_vertex(self):
        mesh = "{ vertices: 4, order: [0, 1, 2, 3, 0], triangles: [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3] }"
        ask = f"(s => [[...s.places], [...s.normals], s.stamp])(makeShape({mesh}).take([0,0,0, 1,0,0, 0,1,0, 0,0,1]))"
        places, normals, stamp = asked_of_node(self.MESH, "makeShape", ask)
        places, normals = np.reshape(places, (5, 3)), np.reshape(normals, (5, 3))
        assert np.array_equal(places[4], places[0])
        assert np.array_equal(normals[4], normals[0])
        assert (((places - places[:4].mean(0)) * normals).sum(1) > 0).all()
        assert stamp == 1

    def test_the_browser_ties_parts_to_the_head_as_the_kernel_does(self):
        kofi = load_character("kofi")
        growth, part = [1.1, 0.9, 1.2], next(worn.part for worn in kofi.worn if worn.part.kind == "brows")
        used = np.unique(part.anchors)
        vertices = np.zeros_like(kofi.model.neutral)
        vertices[used] = np.round(kofi.person.neutral[used], 3)
        arrays = {name: getattr(part, name).ravel().tolist() for name in ("anchors", "weights", "offsets")}
        flat = json.dumps({int(3 * v + axis): vertices[v, axis] for v in used for axis in range(3)})
        ask = f"[...tied({json.dumps(arrays)}, {flat}, 2, {growth}, new Float64Array({3 * len(part.offsets)}))]"
        found = np.reshape(asked_of_node(self.WORN, "tied", ask), (-1, 3))
        np.testing.assert_allclose(found, part.on(2.0 * vertices, np.array(growth)), atol=1e-9)

    def test_the_ends_of_a_rod_are_round_and_turn_their_outsides_out(self):
        ask = "(r => [[...r.corners], [...r.triangles]])(roundEnds())"
        corners, triangles = (np.array(part) for part in asked_of_node(self.RODS, "roundEnds", ask))
        corners, triangles = corners.reshape(-1, 4), triangles.reshape(-1, 3)
        assert np.linalg.norm(corners[:, :3], axis=1) == pytest.approx(1.0)
        rod = corners[:, :3] + [0.0, 0.0, 5.0] * corners[:, 3:]
        area = face_normals(rod, triangles)
        drawn = np.linalg.norm(area, axis=1) > 1e-9
        outwards = rod[triangles].mean(1) - np.clip(rod[triangles].mean(1) * [0, 0, 1], 0.0, 5.0)
        assert ((area * outwards).sum(1) > 0)[drawn].all()
        assert set(triangles.ravel()) == set(range(len(corners)))


@needs_node
class TestLivePanel:
    SILENCE, LEAVING = BROWSER / "live" / "silence.js", BROWSER / "live" / "leaving.js"
    CLOCK = """
        let now = 0, timers = [];
        globalThis.setTimeout = (run, ms) => (timers.push({ run, at: now + ms }), timers.at(-1));
        globalThis.clearTimeout = (timer) => (timers = timers.filter((other) => other !== timer));
        const until = (then) => {
            for (let next; (next = timers.filter(({ at }) => at <= then).sort((a, b) => a.at - b.at)[0]); ) {
                now = next.at;
                clearTimeout(next);
                next.run();
            }
            now = then;
        };
        const told = [], leaving = makeLeaving(() => told.push(["gone", now]), () => told.push(["left", now]));
    """
    """A clock of the test's own, and whom a display that has gone is told to."""

    def told(self, happened: str) -> object:
        return asked_of_node(self.LEAVING, "makeLeaving", f"(() => {{ {self.CLOCK} {happened}; return told; }})()")

    def test_no_more_than_two_frames_wait_for_an_answer_until_they_are_forgotten(self):
        camera = """
            const tracks = [{ stop() {}, addEventListener() {} }];
            const stream = { getTracks: () => tracks, getVideoTracks: () => tracks };
            const mediaDevices = { getUserMedia: async () => stream };
            Object.defineProperty(globalThis, "navigator", { value: { mediaDevices } });
            let next = null;
            const frames = (count) => { for (let k = 0; k < count; k++) next(); };
            const film = { videoWidth: 640, videoHeight: 480, play: async () => {} };
            const video = { ...film, requestVideoFrameCallback: (run) => (next = run) };
            const canvas = { getContext: () => ({ drawImage() {} }), toDataURL: () => "data:image/jpeg;base64,AAAA" };
            globalThis.document = { createElement: (kind) => (kind === "video" ? video : canvas) };
            const sent = [], camera = makeCamera(({ number }) => sent.push(number), () => {});
        """
        happened = """
            const seen = [camera.isClosed()], look = () => seen.push(sent.splice(0));
            await camera.open([640, 480]), frames(5), look();
            camera.release(0), frames(5), look();
            camera.forget(), frames(5), look();
            await camera.open([640, 480]), frames(5), look(); // whoever asks has forgotten them, too
            seen.push(camera.isClosed()), camera.close(), seen.push(camera.isClosed());
            return seen;
        """
        path = BROWSER / "live" / "camera.js"
        seen = asked_of_node(path, "makeCamera", f"await (async () => {{ {camera} {happened} }})()")
        assert seen == [True, [0, 1], [2], [3, 4], [5, 6], False, True]

    def test_silence_counts_from_the_first_frame_without_an_answer(self):
        ask = """(() => {
            const silence = makeSilence(), seen = [];
            const look = (now) => seen.push([silence.isSlow(now), silence.isOver(now)]);
            silence.onFrame(0), silence.onAnswer(), look(90000); // a long pause: nothing is owed
            silence.onFrame(100000), look(102000), silence.onFrame(102500), look(103500), look(161000);
            silence.onAnswer(), look(161000);
            return seen;
        })()"""
        quiet, slow, over = [False, False], [True, False], [True, True]
        assert asked_of_node(self.SILENCE, "makeSilence", ask) == [quiet, quiet, slow, over, quiet]

    def test_a_frame_without_an_answer_counts_as_lost_after_five_seconds_and_so_does_the_next(self):
        ask = """(() => {
            const silence = makeSilence(), seen = [];
            const look = (now) => seen.push(silence.isLost(now));
            look(9000), silence.onFrame(10000), look(14000), look(15500), silence.onFrame(15500), look(16000);
            look(21000), silence.onAnswer(), look(30000);
            return seen;
        })()"""
        assert asked_of_node(self.SILENCE, "makeSilence", ask) == [False, False, True, False, True, False]

    def test_a_display_that_has_gone_closes_the_camera_and_only_later_ends_the_run(self):
        assert self.told("leaving.start(), until(20000)") == [["gone", 1500], ["left", 8000]]

    @pytest.mark.parametrize(("back_ms", "told"), [(1000, []), (5000, [["gone", 1500]])])
    def test_a_display_that_comes_back_does_not_end_the_run(self, back_ms, told):
        assert self.told(f"leaving.start(), until({back_ms}), leaving.stop(), until(20000)") == told

    def test_a_second_display_that_goes_starts_the_wait_again(self):
        happened = "leaving.start(), until(1000), leaving.stop(), until(1200), leaving.start(), until(20000)"
        assert self.told(happened) == [["gone", 2700], ["left", 9200]]

    def test_it_is_under_way_until_somebody_is_back_or_all_is_over(self):
        happened = """for (const [then, act] of [[0, "start"], [1600], [2000, "stop"], [2100, "start"], [20000]]) {
            until(then);
            if (act) leaving[act]();
            told.push(leaving.isUnderWay());
        }"""
        assert [word for word in self.told(happened) if isinstance(word, bool)] == [True, True, False, True, False]


@needs_node
class TestPanel:
    HELP, KEYS, CROP, VIEWPOINT = (
        BROWSER / name for name in ("panel/help.js", "panel/keys.js", "head/crop.js", "head/viewpoint.js")
    )

    def test_keys_have_their_actions_in_small_and_capital_letters(self):
        ask = '["n", "N", ",", ".", " ", "?", "M", "_", "Enter", "q"].map((key) => actionOf(key) ?? null)'
        wanted = ["next", "next", "back", "forth", "play", "help", "overlay", "overlay", None, None]
        assert asked_of_node(self.HELP, "actionOf", ask) == wanted

    def test_every_action_of_a_key_is_done_by_the_page_or_the_panel(self):
        named = asked_of_node(self.HELP, "KEYS", 'KEYS.flatMap(([, , , actions]) => actions.split(" "))')
        assert set(named) - {"overlay", "search", "help"} <= set(ACTIONS)
        assert set(ACTIONS) - set(named) == {"undo", "redo"}  # with Ctrl

    def test_one_esc_closes_the_help_and_the_next_clears_the_selection(self):
        page = """
            const document = globalThis.document = Object.assign(new EventTarget(), { closest: () => null });
            const overlay = { dispatchEvent: ({ detail }) => seen.push(detail) }, seen = [];
            let open = true;
            const close = () => open && (open = false, Boolean(seen.push("closed")));
            listenToKeys({ help: { close }, holds: () => true, panel: () => ({ querySelector: () => overlay }) });
            const press = () => document.dispatchEvent(
              Object.assign(new Event("keydown", { cancelable: true }), { key: "Escape" }));
            press(), seen.push("again"), press();
        """
        ask = f"(() => {{ {page} return seen; }})()"
        assert asked_of_node(self.KEYS, "listenToKeys", ask) == ["closed", "again", "Escape"]

    def test_the_head_is_seen_through_the_crop_of_the_photo(self):
        """A point of the picture lies as far from the middle of the head's stage as from that of the photo's."""
        lens, crop = [500, 510, 320, 180], {"scale": 2.5, "x": -300, "y": -120, "width": 400, "height": 300}
        fx, fy, cx, cy = asked_of_node(self.CROP, "throughCrop", f"throughCrop({lens}, {json.dumps(crop)}, [260, 300])")
        point = np.array([12.0, -30.0, 700.0])
        pixel = np.array([500 * point[0] / point[2] + 320, 510 * point[1] / point[2] + 180])
        on_photo = 2.5 * pixel + [-300, -120] - np.array([400, 300]) / 2
        on_head = np.array([fx * point[0] / point[2] + cx, fy * point[1] / point[2] + cy]) - np.array([260, 300]) / 2
        np.testing.assert_allclose(on_head, on_photo)

    def test_what_is_in_view_stays_in_view_on_a_stage_of_another_shape(self):
        pose = {"camera": [600, 600, 151.5, 153.5], "size": [304, 308], "turn": [], "shift": [], "pivot": []}
        found = asked_of_node(self.VIEWPOINT, "stretched", f"stretched({json.dumps(pose)}, [608, 400])")
        assert found["size"] == [608, 400]
        assert found["camera"] == pytest.approx([600 * 400 / 308, 600 * 400 / 308, 303.5, 199.5])
