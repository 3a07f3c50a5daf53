"""The light panel without a browser: a lamp, its nine numbers, and a picture that follows, from any thread."""

import threading

import cv2
import numpy as np
import pytest

from workbench.errors import InputError
from workbench.plots import as_picture, ball_normals
from workbench.rendering import ambient_light, directional_light, spherical_harmonics
from workbench.rendering.lighting import LAMBERT
from workbench.runtime import COMPUTING
from workbench.widgets import LightPanel
from workbench.widgets.light_panel import (
    BALL_ALBEDO,
    BALL_PX,
    FUNCTIONS,
    MARGIN_PX,
    SIDE_PX,
    START,
    lamp_light,
    lit_ball,
)

MIDDLE = SIDE_PX // 2
OWN = (BALL_PX / 2, SIDE_PX + MARGIN_PX + BALL_PX // 2)
"""Radius and middle of the panel's own ball."""
NORMALS = np.nan_to_num(ball_normals(40))


def ball_in_light(light: np.ndarray) -> np.ndarray:
    """What the panel is given to draw: here a ball like its own, without a renderer."""
    return (
        BALL_ALBEDO * np.stack(spherical_harmonics(*np.moveaxis(NORMALS, -1, 0)), axis=-1) @ (LAMBERT[:, None] * light)
    )


@pytest.fixture
def drawn():
    return []


@pytest.fixture
def panel(drawn):
    def draw(light):
        drawn.append(light)
        return ball_in_light(light)

    made = LightPanel(draw)
    yield made
    made.close()


def shown(panel) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(panel.image.value, np.uint8), cv2.IMREAD_COLOR).astype(float)


def halves(picture: np.ndarray) -> tuple[float, float, float, float]:
    """Brightness of the left, right, upper and lower half."""
    rows, columns = picture.shape[0] // 2, picture.shape[1] // 2
    return picture[:, :columns].mean(), picture[:, -columns:].mean(), picture[:rows].mean(), picture[-rows:].mean()


def test_the_panel_shows_what_was_drawn_beside_a_ball_in_the_same_light(panel):
    picture = shown(panel)
    assert picture.shape == (SIDE_PX, SIDE_PX + BALL_PX + 2 * MARGIN_PX, 3)
    for x, y in ((0.0, 0.0), (-0.4, 0.3), (0.5, -0.2)):  # from the middle, in ball sizes
        places = [(MIDDLE + round(side * y), centre + round(side * x)) for side, centre in ((SIDE_PX / 2, MIDDLE), OWN)]
        assert abs(picture[places[0]].mean() - picture[places[1]].mean()) < 6


@pytest.mark.parametrize(
    ("azimuth", "elevation", "bright", "dark"), [(90, 0, 1, 0), (-90, 0, 0, 1), (0, 80, 2, 3), (0, -80, 3, 2)]
)
def test_the_lamp_lights_the_side_it_stands_on(azimuth, elevation, bright, dark):
    sides = halves(lit_ball(lamp_light(azimuth, elevation, 1.0, 0.1), 101).astype(float))
    assert sides[bright] > sides[dark] + 30


def test_a_lamp_at_the_camera_and_one_behind_the_head_are_opposites():
    np.testing.assert_allclose(
        lamp_light(0, 0, 0.7, 0.2), directional_light((0.0, 0.0, -1.0), 0.7) + ambient_light(0.2)
    )
    np.testing.assert_allclose(lamp_light(180, 0, 0.7, 0), directional_light((0.0, 0.0, 1.0), 0.7), atol=1e-12)


@pytest.mark.parametrize(("name", "value"), [("azimuth", 60), ("elevation", -30), ("lamp", 1.5), ("ambient", 0.9)])
def test_moving_the_lamp_draws_once_with_its_nine_coefficients(panel, drawn, name, value):
    before = len(drawn)
    panel.lamp[name].value = value
    assert len(drawn) == before + 1
    np.testing.assert_allclose(drawn[-1], lamp_light(**{**START, name: value}))
    np.testing.assert_allclose([slider.value for slider in panel.coefficients], drawn[-1][:, 0])
    assert panel.light is drawn[-1]


def test_the_brightest_light_is_in_the_range_of_the_coefficients(panel, drawn):
    panel.lamp["lamp"].value, panel.lamp["ambient"].value = panel.lamp["lamp"].max, panel.lamp["ambient"].max
    for azimuth in range(-180, 181, 45):
        panel.lamp["azimuth"].value = azimuth
        np.testing.assert_allclose([slider.value for slider in panel.coefficients], drawn[-1][:, 0])


def test_a_coefficient_moved_by_itself_leaves_the_others_and_the_lamp(panel, drawn):
    before, lamp = panel.light.copy(), {name: slider.value for name, slider in panel.lamp.items()}
    k = FUNCTIONS.index("x")
    panel.coefficients[k].value = 1.7
    np.testing.assert_allclose(np.delete(drawn[-1], k, axis=0), np.delete(before, k, axis=0))
    np.testing.assert_allclose(drawn[-1][k], 1.7)
    assert {name: slider.value for name, slider in panel.lamp.items()} == lamp


def test_a_light_of_any_colour_can_be_shown(panel, drawn):
    light = ambient_light((1.0, 0.5, 0.2))
    panel.use(light)
    np.testing.assert_array_equal(drawn[-1], light)
    blue, green, red = shown(panel)[MIDDLE, OWN[1]]
    assert red > green > blue


def test_sliders_may_move_in_other_threads_and_drawing_holds_the_lock():
    others = []

    def draw(light):
        def ask():
            free = COMPUTING.acquire(blocking=False)
            others.append(free)
            if free:
                COMPUTING.release()

        asking = threading.Thread(target=ask)
        asking.start()
        asking.join(timeout=10)
        return ball_in_light(light)

    panel = LightPanel(draw)
    threads = [
        threading.Thread(target=lambda value=value: setattr(panel.lamp["azimuth"], "value", value))
        for value in range(-90, 90, 15)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=30)
    assert others
    assert not any(others)
    expected = lamp_light(**{name: slider.value for name, slider in panel.lamp.items()})
    np.testing.assert_allclose(panel.light, expected)
    panel.close()


def test_what_cannot_be_drawn_is_explained_and_the_next_move_recovers(drawn):
    def draw(light):
        if light[0, 0] < 0:
            raise InputError("a <light> should not be dark, move it up")
        return ball_in_light(light)

    panel = LightPanel(draw)
    picture, light = panel.image.value, panel.light
    panel.coefficients[0].value = -1.0
    assert "a &lt;light&gt; should not be dark" in panel.status.value
    assert panel.image.value == picture
    assert panel.light is light
    panel.coefficients[0].value = 1.0
    assert "drawn in" in panel.status.value
    assert panel.image.value != picture
    panel.close()


def test_the_picture_of_a_ball_is_clipped_and_has_a_background():
    ball = lit_ball(ambient_light(2.0), 50)
    assert (ball[25, 25] == 255).all()
    np.testing.assert_array_equal(ball[0, 0], as_picture(np.full((1, 1, 3), 0.2))[0, 0])


def test_the_representation_shows_the_nine_numbers(panel):
    panel.use(ambient_light(1.0))
    assert repr(panel) == "LightPanel([3.54, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])"
