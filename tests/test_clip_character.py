"""The person in a clip as a character: a skin from pictures against the true one, and what becomes of a track."""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

from tests.optional_parts import needs_gl
from workbench.config import preset
from workbench.errors import InputError, ModelError
from workbench.face import DressedHead, find_character, load_character, load_default_head, read_skin, skin_names
from workbench.frames import open_frames
from workbench.geometry import axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.pictures import HeadRenderer
from workbench.pictures.mesh import to_camera
from workbench.pipeline.clip_character import Wardrobe, candidates, character_of_clip, sharpness, usable_fits
from workbench.rendering.skin_texture import (
    FULL_WEIGHT,
    PaintedSkin,
    SkinView,
    closest_skin,
    completed_skin,
    painted_skin,
)
from workbench.rendering.uv_map import drawn_triangles, uv_map
from workbench.samples import sample
from workbench.session import open_session
from workbench.tracking.records import SOURCES

SIZE = 256
IMAGE = (320, 240)
SKINS = ("middleage_lightskinned_male2", "old_darkskinned_male", "young_lightskinned_female")
OVER_SKIN = ("hair", "brows", "lashes")


@lru_cache
def bare(name: str) -> DressedHead:
    """A character without what hides its skin."""
    head = load_character(name)
    return replace(head, worn=tuple(worn for worn in head.worn if worn.part.kind not in OVER_SKIN))


@lru_cache
def film(name: str) -> tuple[SkinView, ...]:
    """Five views of a character, whose geometry is known."""
    head, camera = bare(name), camera_from_fov(IMAGE, 26.0)
    vertices, translation = head.person.neutral, np.array([0.0, 10.0, 640.0])
    views = []
    with HeadRenderer(head.person, IMAGE, supersampling=2.0, dressed=head) as renderer:
        for yaw in (-35.0, -15.0, 0.0, 15.0, 35.0):
            rotation = axis_angle_from_yaw_pitch_roll(np.array([yaw, 0.0, 0.0]))
            picture = renderer.render(vertices, camera, rotation, translation, (150, 140, 128))
            views.append(SkinView(picture, to_camera(vertices, rotation, translation), camera))
    return tuple(views)


@lru_cache
def painted(name: str):
    return painted_skin(film(name), bare(name).model, SIZE)


def true_skin(name: str) -> np.ndarray:
    return cv2.resize(bare(name).skin, (SIZE, SIZE), interpolation=cv2.INTER_AREA) / 255.0


def error(color: np.ndarray, name: str, where: np.ndarray) -> float:
    """Mean difference of 255 levels, with one factor per channel, which no picture tells, taken out."""
    true = true_skin(name)[where]
    return 255.0 * float(np.abs(color[where] * (true.mean(axis=0) / color[where].mean(axis=0)) - true).mean())


def test_texels_lie_in_their_triangles():
    model = load_default_head()
    mapped = uv_map(model, SIZE)
    places = np.einsum("rcj,rcjd->rcd", mapped.barycentric, model.uv[model.triangles_uv[mapped.triangle]])
    rows, columns = np.mgrid[0:SIZE, 0:SIZE]
    wanted = np.stack([(columns + 0.5) / SIZE, 1.0 - (rows + 0.5) / SIZE], axis=-1)
    assert SIZE * np.abs(places - wanted)[mapped.inside].max() < 1e-6
    assert 0.4 < mapped.inside.mean() < 1.0
    # Beside the islands lies what is nearest inside.
    assert set(np.unique(mapped.triangle[~mapped.inside])) <= set(np.unique(mapped.triangle[mapped.inside]))


def test_of_triangles_that_overlap_the_last_counts_and_without_any_nothing_is_drawn():
    whole = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]])
    small = 0.5 * whole
    for triangles in ([whole, small], [small, whole]):
        drawn, barycentric = drawn_triangles(np.array(triangles), 600)  # more texels than are looked at together
        assert set(np.unique(drawn)) == ({0, 1} if triangles[1] is small else {1})
        np.testing.assert_allclose(barycentric.sum(axis=-1), 1.0)
    drawn, barycentric = drawn_triangles(np.zeros((0, 3, 2)), 8)
    assert (drawn == -1).all()
    assert not barycentric.any()


def test_a_dark_line_is_a_brow_above_the_brows_landmarks_and_something_else_on_the_forehead():
    """Brows are often higher than the model's; the strand of a fringe is no skin."""
    model, skin = load_default_head(), true_skin("bruno")
    points = model.landmarks.of(model.neutral)[18:21]
    mapped = uv_map(model, SIZE)
    place = mapped.of(model.neutral)
    inside = mapped.inside & (np.abs(place[..., 0] - points[1, 0]) < 11.0) & (place[..., 2] < 0.0)
    brow, strand = (inside & (np.abs(place[..., 1] - points[1, 1] + above) < 3.0) for above in (7.0, 32.0))
    color = skin.copy()
    color[brow | strand] = 0.08
    skins = {name: read_skin(name) for name in SKINS[:1]}
    completed, _ = completed_skin(PaintedSkin(color, np.full((SIZE, SIZE), 2.0 * FULL_WEIGHT)), model, skins)
    shown = completed / 255.0
    assert brow.sum() > 20
    assert strand.sum() > 20
    assert np.median(shown[brow]) < 0.15
    assert np.median(shown[strand]) > 0.3


def test_a_model_without_texture_coordinates_is_refused():
    with pytest.raises(InputError, match="no texture coordinates"):
        uv_map(replace(load_default_head(), uv=np.zeros((1, 2))), SIZE)


@needs_gl
@pytest.mark.parametrize(("name", "most"), [("bruno", 4.5), ("kofi", 4.0), ("edda", 7.0)])
def test_a_skin_is_recovered_from_a_film_of_it(name, most):
    found = painted(name)
    seen = found.seen > FULL_WEIGHT
    assert seen.mean() > 0.15
    miss = error(found.color, name, seen)
    assert miss < most
    skins = [cv2.resize(read_skin(other), (SIZE, SIZE), interpolation=cv2.INTER_AREA) / 255.0 for other in skin_names()]
    assert miss < np.median([error(skin, name, seen) for skin in skins])
    # Drawn as heads are, the face is as bright as in the pictures.
    ratio = found.color[seen].mean() / true_skin(name)[seen].mean()
    assert 0.85 < ratio < 1.2


@needs_gl
def test_something_before_the_face_in_one_view_counts_for_nothing():
    views = list(film("bruno"))
    height, width = views[2].picture.shape[:2]
    covered = views[2].picture.copy()
    covered[height // 2 : height // 2 + 40, width // 2 - 30 : width // 2 + 30] = (20, 60, 200)
    views[2] = replace(views[2], picture=covered)
    with_hand = painted_skin(views, bare("bruno").model, SIZE)
    seen = (with_hand.seen > FULL_WEIGHT) & (painted("bruno").seen > FULL_WEIGHT)
    assert error(with_hand.color, "bruno", seen) < error(painted("bruno").color, "bruno", seen) + 1.0


@needs_gl
def test_the_rest_comes_from_the_most_alike_skin_in_the_same_tone():
    found, model = painted("bruno"), bare("bruno").model
    own = "middleage_lightskinned_male2"
    assert closest_skin(found, {name: read_skin(name) for name in SKINS}) == own
    others = {name: read_skin(name) for name in SKINS if name != own}
    skin, name = completed_skin(found, model, others)
    assert name in others
    unseen = (found.seen == 0.0) & uv_map(model, SIZE).inside
    for region in ("scalp", *(name for name in model.regions if name not in ("skin", "lips", "brow"))):
        inside = np.zeros(len(model.neutral))
        inside[model.regions[region]] = 1.0
        unseen &= uv_map(model, SIZE).of(inside) == 0.0
    plain = cv2.resize(others[name], (SIZE, SIZE), interpolation=cv2.INTER_AREA)
    true = 255.0 * true_skin("bruno")
    assert np.abs(skin - true)[unseen].mean() < np.abs(plain - true)[unseen].mean()
    # No seam: pasted as it is, the painted part stands out from the other skin at its border.
    pasted = np.where(found.seen[..., None] > 0.0, 255.0 * found.color, plain)
    around = np.ones((5, 5), np.uint8)
    border = cv2.dilate((found.seen > 0.0).astype(np.uint8), around) != cv2.erode(
        (found.seen > 0.0).astype(np.uint8), around
    )
    border &= np.roll(unseen, 6, axis=0) | np.roll(unseen, -6, axis=0)

    def step(picture: np.ndarray) -> float:
        return float(np.abs(np.diff(picture.astype(float), axis=0)).mean(axis=2)[border[1:]].mean())

    assert step(skin) < 0.6 * step(pasted)


def test_a_face_that_no_view_shows_large_enough_is_refused():
    model, camera = load_default_head(), camera_from_fov((64, 48), 30.0)
    view = SkinView(np.zeros((48, 64, 3), np.uint8), model.neutral + np.array([0.0, 0.0, 3000.0]), camera)
    with pytest.raises(InputError, match="No picture shows the face large enough"):
        painted_skin([view], model, SIZE)


@pytest.fixture(scope="module")
def tracked():
    """The first second of a clip, and its frames."""
    config = preset("joint").changed(camera={"fov_deg": 33.0})
    session = open_session(sample("laugh"), config, landmarks=sample("laugh-landmarks"))
    session.fit_clip()
    return session.track


def test_calm_frames_of_every_side_are_chosen(tracked):
    groups = candidates(usable_fits(tracked))
    assert len(groups) >= 3
    jaw = tracked.expression_names.index("jawOpen")
    chosen = [fit for group in groups for fit in group]
    assert np.mean([fit.expression[jaw] for fit in chosen]) < tracked.expression[:, jaw].mean()
    assert len({fit.index for fit in chosen}) == len(chosen)


def test_filled_frames_tell_nothing_of_the_skin(tracked):
    """Nobody saw a face in them, and what stands for its landmarks fits perfectly."""
    confidence, observed, source = (getattr(tracked, name).copy() for name in ("confidence", "observed", "source"))
    filled = slice(2, 9)
    confidence[filled], observed[filled], source[filled] = 0.0, tracked.projected[filled], SOURCES.index("filled")
    track = replace(tracked, confidence=confidence, observed=observed, source=source)
    assert not {fit.source for fit in usable_fits(track)} & {"filled"}


def test_a_blurred_face_is_less_sharp(tracked):
    picture = next(open_frames(sample("laugh")).iterate(0)).picture
    assert sharpness(cv2.GaussianBlur(picture, (0, 0), 3.0), tracked[0]) < 0.2 * sharpness(picture, tracked[0])


@pytest.mark.long
def test_the_person_in_a_clip_becomes_a_character(tracked, run, monkeypatch, tmp_path):
    """By the command, whose work is that of `character_of_clip`."""
    tracked.save(tmp_path / "run" / "track.npz")
    returned = []

    def noted(*arguments):
        returned.append(character_of_clip(*arguments))
        return returned[0]

    monkeypatch.setattr("workbench.pipeline.clip_character.character_of_clip", noted)
    options = ["--pictures", str(sample("laugh")), "--hair", "short01", "--eyes", "grey"]
    code, out, _ = run("character", "run", "--out", "me", *options)
    assert code == 0
    assert "name it with --character" in out
    (made,) = returned
    assert made.seen_share > 0.1
    assert len(made.frames) >= 5
    for name in (str(tmp_path / "me"), str(tmp_path / "me" / "character.toml")):
        assert preset("joint").changed(head={"character": name}).head.character == name
        head = load_character(name)
    np.testing.assert_allclose(head.character.identity, tracked.identity[0], atol=1e-3)
    assert head.character.eyes == "grey"
    assert {worn.part.kind for worn in head.worn} >= {"hair", "clothes", "eyes"}
    assert "brows" not in {worn.part.kind for worn in head.worn}
    # As brown as the man himself, and his hair as dark.
    face = head.skin[300:600, 400:620].reshape(-1, 3).mean(axis=0)
    true = cv2.resize(load_character("ravi").skin, (1024, 1024))[300:600, 400:620].reshape(-1, 3).mean(axis=0)
    assert np.abs(face / face.sum() - true / true.sum()).max() < 0.08
    assert np.mean(head.character.hair_color) < 90.0


def test_what_is_not_there_is_said_before_the_work(tracked, tmp_path):
    frames = open_frames(sample("laugh"))
    with pytest.raises(ModelError, match="no style 'mohawk' for hair"):
        character_of_clip(tracked, frames, tmp_path / "me", Wardrobe(hair="mohawk"))
    with pytest.raises(ModelError, match="no style 'violet' for eyes"):
        character_of_clip(tracked, frames, tmp_path / "me", Wardrobe(eyes="violet"))
    other = replace(tracked, meta=tracked.meta | {"model": {"name": "flame"}})
    with pytest.raises(InputError, match="fitted with flame"):
        character_of_clip(other, frames, tmp_path / "me")
    empty = replace(tracked, found=np.zeros(len(tracked), bool))
    with pytest.raises(InputError, match="No frame of this track has a usable face"):
        character_of_clip(empty, frames, tmp_path / "me")
    assert not (tmp_path / "me").exists()


@pytest.mark.parametrize("name", ["mei", "plain"])
def test_a_name_that_means_another_character_is_refused(name, tracked, run, tmp_path):
    tracked.save(tmp_path / "run" / "track.npz")
    code, _, err = run("character", "run", "--out", name)
    assert code == 2
    assert f"--character {name} is a bundled character; name another folder" in err
    assert not (tmp_path / name).exists()


def test_a_colour_is_three_numbers(tracked, run, tmp_path):
    tracked.save(tmp_path / "run" / "track.npz")
    code, _, err = run("character", "run", "--out", "me", "--hair-color", "red")
    assert code == 2
    assert "three numbers from 0 to 255" in err


@pytest.mark.parametrize("color", ["300,0,0", "-1,0,0", "nan,0,0"])
def test_a_colour_that_no_character_can_have_is_refused_before_the_work(color, tracked, run, tmp_path):
    tracked.save(tmp_path / "run" / "track.npz")
    options = ["--pictures", str(sample("laugh")), "--hair", "short02", "--hair-color", color]
    code, _, err = run("character", "run", "--out", "me", *options)
    assert code == 2
    assert "three numbers from 0 to 255" in err
    assert not (tmp_path / "me").exists()


def test_a_folder_without_a_character_is_none(tmp_path):
    with pytest.raises(ModelError, match=r"a folder with a character\.toml"):
        find_character(str(tmp_path))
