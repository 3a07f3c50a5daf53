"""The avatar player without a browser: frames, gaps, views, and a kernel that cannot follow."""

import threading
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.performances import FRAMES, GAP, other_character, performance
from workbench.errors import InputError
from workbench.export import retarget
from workbench.face import load_character
from workbench.frames import VideoWriter, open_frames
from workbench.tracking.records import ARRAYS
from workbench.widgets import AvatarPlayer


@pytest.fixture(scope="module")
def track(head):
    return performance(head)


@pytest.fixture
def player(track, head):
    made = AvatarPlayer(track, head, backend="webgl")
    yield made
    made.close()


def shown(player):
    return player.view._shown.vertices


def test_it_starts_at_the_first_frame_and_follows_the_slider(player, track, head):
    person = head.personal(track.identity[0])
    np.testing.assert_allclose(shown(player), person.vertices(track.expression[0]), atol=1e-3)
    player.slider.value = FRAMES - 1
    assert player.wait_idle()
    np.testing.assert_allclose(shown(player), person.vertices(track.expression[-1]), atol=1e-3)
    assert "yaw -30°, pitch +20°, roll +10°" in player.status.value


def test_the_browser_counts_at_the_rate_of_the_clip(player):
    assert (player.play.min, player.play.max, player.play.interval) == (0, FRAMES - 1, 40)


def test_a_frame_without_a_face_keeps_the_last_one_and_says_so(player):
    player.slider.value = GAP - 1
    assert player.wait_idle()
    before = shown(player).copy()
    player.slider.value = GAP
    assert player.wait_idle()
    np.testing.assert_array_equal(shown(player), before)
    assert "no face" in player.status.value


def test_the_view_of_the_camera_moves_with_the_pose(player):
    player.looking.value = "camera"
    first = list(player.view.canvas._viewpoint)
    player.slider.value = FRAMES - 1
    assert player.wait_idle()
    assert np.abs(np.array(player.view.canvas._viewpoint) - first).max() > 50.0


def test_callbacks_from_many_threads_end_at_the_newest_frame(player, track, head):
    threads = [threading.Thread(target=player._worker.submit, args=(k,)) for k in range(FRAMES)]
    for thread in threads:
        thread.start()
        thread.join()
    assert player.wait_idle()
    person = head.personal(track.identity[0])
    np.testing.assert_allclose(shown(player), person.vertices(track.expression[-1]), atol=1e-3)
    assert player._worker.started <= FRAMES


def test_another_character_plays_the_same_track(track, head):
    character = other_character(head, np.zeros(50), keep=0.3)
    player = AvatarPlayer(retarget(track, character), character, backend="webgl")
    assert shown(player).shape == character.neutral.shape
    assert repr(player) == f"AvatarPlayer({FRAMES} frames, 'other')"
    player.close()


def test_the_input_stands_beside_the_head(track, head, tmp_path):
    with VideoWriter(tmp_path / "clip.mp4") as writer:
        for k in range(FRAMES):
            writer.write(np.full((480, 640, 3), 60 + 10 * k, np.uint8))
    player = AvatarPlayer(track, head, open_frames(tmp_path / "clip.mp4"), height_px=240, backend="webgl")
    player.slider.value = 7
    assert player.wait_idle()
    picture = cv2.imdecode(np.frombuffer(player.image.value, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (240, 320, 3)
    assert abs(int(np.median(picture)) - 130) < 6
    player.close()


def test_an_error_while_playing_is_shown(player, monkeypatch):
    monkeypatch.setattr(player.view, "set_vertices", lambda vertices, rest: 1 / 0)
    player.slider.value = 3
    assert player.wait_idle()
    assert "division by zero" in player.status.value


def test_a_track_of_another_model_is_refused(track, head):
    with pytest.raises(InputError, match="retarget it"):
        AvatarPlayer(track, head.with_expressions(("jawOpen",)))
    nothing = replace(track, **{name: getattr(track, name)[:0] for name in ARRAYS})
    with pytest.raises(InputError, match="nothing to play"):
        AvatarPlayer(nothing, head)


def test_a_character_plays_with_the_fitted_face(head):
    dressed = load_character("kofi")
    track = performance(head, frames=2, gap=None)
    player = AvatarPlayer(track, head, backend="pictures", dressed=dressed)
    plain = AvatarPlayer(track, head, backend="pictures")
    try:
        shown = [each.view.snapshot().astype(int) for each in (player, plain)]
        assert np.abs(shown[0] - shown[1]).mean() > 5.0
    finally:
        player.close()
        plain.close()
