"""Characters in the energies' own renderer: a skin as the texture, hair as something outside of the face."""

import os
from dataclasses import replace
from functools import lru_cache

import jax
import numpy as np
import pytest

from tests.optional_parts import needs_gl
from workbench.config import preset
from workbench.errors import ModelError
from workbench.face import FaceParameters, find_character, load_character, load_default_head, posed_vertices
from workbench.face.dressed_head import dress
from workbench.geometry import Camera, axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.pictures import HeadRenderer
from workbench.pictures.mesh import to_camera
from workbench.planning import plan_of
from workbench.rendering import (
    Appearance,
    Texture,
    ambient_light,
    character_look,
    cover_vertices,
    covered,
    directional_light,
    face_vertices,
    hidden_pixels,
    known_appearance,
    plain_look,
    render,
    render_face,
    render_model,
    vertex_colors,
)
from workbench.session.dependence import fits_key
from workbench.tracking.deep_fitter import DeepFitter

SIZE = (120, 120)
GREY = np.full(3, 0.45, np.float32)
LIGHT = (ambient_light(0.55) + directional_light((0.3, -0.4, -1.0), 0.45)).astype(np.float32)
CAMERA = Camera(*(np.asarray(part, np.float32) for part in camera_from_fov(SIZE, 26.0)))
FRINGE, BALD = "nora", "thabo"


@lru_cache
def look_of(name):
    return character_look(load_character(name, gaze=False), side=256)


@pytest.fixture(scope="module")
def model(head):
    return render_model(head)


def facing(yaw_deg=0.0, identity=(), scale=1.0) -> FaceParameters:
    parts = (axis_angle_from_yaw_pitch_roll(np.array([yaw_deg, 3.0, 0.0])), [0.0, 15.0, 620.0], np.zeros(44), identity,
             np.zeros(6), [scale])  # fmt: skip
    return FaceParameters(*(np.asarray(part, np.float32) for part in parts))


def pictured(model, albedo, parameters):
    """The face as centres of pixels show it, quick to compile."""
    return np.asarray(
        render_face(model, parameters, CAMERA, albedo, LIGHT, GREY, size=SIZE, samples=2, antialias=False).color
    )


def test_a_face_of_a_texture_has_its_colours_at_the_vertices(head):
    """In the pictures' own encoding: what a full light from everywhere shows is what the skin's file holds."""
    skin = find_character(BALD).skin
    look, dressed = look_of(BALD), load_character(BALD, gaze=False)
    colors = vertex_colors(look.texture, head)
    uv = np.zeros((len(head.neutral), 2))
    uv[head.triangles] = head.uv[head.triangles_uv]
    size = len(dressed.skin)
    column, row = np.clip((uv * [1, -1] + [0, 1]) * size, 0, size - 1).astype(int).T
    cheeks = np.isin(np.arange(len(uv)), head.regions["skin"]) & ~np.isin(np.arange(len(uv)), head.regions["brow"])
    assert skin.startswith("old_dark")
    difference = np.abs(colors - dressed.skin[row, column] / 255.0)[cheeks].mean(axis=1)
    assert np.median(difference) < 0.01
    # Eyes and teeth, which the skin's picture does not hold, are the plain head's.
    eyes = head.regions["eyeL"]
    np.testing.assert_allclose(colors[eyes], vertex_colors(plain_look(256).texture, head)[eyes], atol=1e-6)


def test_brows_that_are_worn_are_painted_into_the_texture(head):
    character = find_character("bruno")
    with_brows, without = (
        character_look(dress(replace(character, brows=brows), gaze=False), side=256).texture.picture
        for brows in (character.brows, "")
    )
    darker = without.mean(axis=2) - with_brows.mean(axis=2)
    rows, columns = np.nonzero(darker > 0.03)
    uv = np.zeros((len(head.neutral), 2))
    uv[head.triangles] = head.uv[head.triangles_uv]
    points = head.landmarks
    brows = np.einsum("ljd,lj->ld", uv[points.vertices], points.barycentric)[17:27]
    places = np.stack([columns + 0.5, 255.5 - rows], axis=1) / 256
    apart = np.linalg.norm(places[:, None] - brows, axis=2)
    assert 0.001 < (darker > 0.03).mean() < 0.03
    assert apart.min(axis=1).max() < 0.06
    assert apart.min(axis=0).max() < 0.03


def test_a_face_is_found_by_its_texture_where_plain_colours_miss_it(model):
    """A photo of a known texture, compared over turns of the head in light refitted to each: where it matches best."""
    texture, identity = look_of("edda").texture, find_character("edda").identity
    photo = pictured(model, texture, facing(7.0, identity))
    inside = np.abs(photo - GREY).max(axis=2) > 1e-3
    yaws = np.arange(-2.0, 16.1, 1.5) - 0.5

    def best(albedo):
        costs = []
        for yaw in yaws:
            seen = pictured(model, albedo, facing(yaw, identity))[inside]
            factor = (seen * photo[inside]).sum(axis=0) / (seen**2).sum(axis=0)
            costs.append(((factor * seen - photo[inside]) ** 2).mean())
        return abs(yaws[int(np.argmin(costs))] - 7.0), min(costs)

    (textured, least), (plain, rest) = best(texture), best(model.colors)
    assert textured <= 0.5
    assert plain > textured
    assert rest > 10.0 * least


@pytest.mark.long
@needs_gl
def test_hair_hides_what_it_hides_in_the_pictures(model):
    """Against VTK's picture of the same character: what changes as the hair is taken off."""
    character = find_character(FRINGE)
    parameters = facing(20.0, character.identity)
    seen = []
    for hair in (character.hair, ""):
        dressed = dress(replace(character, hair=hair, lashes="eyelashes01"), gaze=False)
        # The scalp under the hair is coloured like it.
        dressed = replace(dressed, skin=np.full_like(dressed.skin, (90, 200, 90)))
        vertices = posed_vertices(dressed.person, np.zeros(44), np.zeros(6))
        with HeadRenderer(dressed.person, SIZE, dressed=dressed) as renderer:
            picture = renderer.render(
                vertices, CAMERA, parameters.rotation, parameters.translation.astype(float), (255, 0, 255)
            )
        seen.append(picture.astype(float))
    truth = np.abs(seen[0] - seen[1]).mean(axis=2) > 25.0
    hidden = np.asarray(hidden_pixels(look_of(FRINGE).cover, model, parameters, CAMERA, size=SIZE))
    assert (truth & hidden).sum() > 0.85 * (truth | hidden).sum()


def test_a_bald_head_and_a_plain_one_have_no_cover():
    assert look_of(BALD).cover is None
    assert plain_look(64).cover is None


def test_pixels_under_hair_show_no_skin_and_change_with_no_unknown(model):
    cover = look_of(FRINGE).cover
    start = facing(15.0, find_character(FRINGE).identity)

    @jax.jit
    def seen(parameters, light):
        face = render_face(model, parameters, CAMERA, model.colors, light, GREY, size=SIZE, antialias=False)
        worn = cover_vertices(cover, model, parameters)
        color, hidden = covered(face, cover, worn, CAMERA, light, size=SIZE)
        return (color, face.color), (hidden, face.coverage)

    way = jax.tree.map(lambda part: np.full_like(part, 0.1), start)
    (color, face), (moved, face_moved), (hidden, coverage) = jax.jvp(
        seen, (start, LIGHT), (way, LIGHT), has_aux=True
    )  # fmt: skip
    hidden, coverage, moved = np.asarray(hidden), np.asarray(coverage) > 0.5, np.asarray(moved)
    assert 0.15 < hidden[coverage].mean() < 0.7
    assert not moved[hidden].any()
    np.testing.assert_array_equal(moved[~hidden], np.asarray(face_moved)[~hidden])
    assert (np.abs(moved[coverage & ~hidden]).max(axis=1) > 0.0).mean() > 0.95
    np.testing.assert_array_equal(np.asarray(color)[~hidden], np.asarray(face)[~hidden])
    # A fringe of fair hair is not the scalp's brown.
    assert np.abs(np.asarray(color) - np.asarray(face))[hidden & coverage].mean() > 0.05


def test_hair_is_tied_to_the_head(model):
    """It turns, grows and moves with the head; expressions leave it where it is."""
    cover, identity = look_of(FRINGE).cover, find_character(FRINGE).identity
    still, twice, turned = (
        np.asarray(cover_vertices(cover, model, facing(yaw, identity, scale)))
        for yaw, scale in ((0.0, 1.0), (0.0, 2.0), (30.0, 1.0))
    )
    dressed = load_character(FRINGE, gaze=False)
    worn = [each.part.kind for each in dressed.worn].index("hair")
    hair = dressed.part_vertices(facing(0.0, identity))[worn]
    whole = cover.shares.max(axis=1) == 1.0
    placed = to_camera(hair[cover.corners[whole, cover.shares[whole].argmax(axis=1)]], *facing()[:2])
    assert whole.sum() > 1000
    np.testing.assert_allclose(still[whole], placed, atol=0.02)
    middle = np.float32(facing().translation)
    np.testing.assert_allclose(twice - middle, 2.0 * (still - middle), atol=0.02)
    assert np.abs(turned - still).max() > 40.0
    laughing = facing(0.0, identity)._replace(expression=np.full(44, 0.5, np.float32))
    np.testing.assert_array_equal(np.asarray(cover_vertices(cover, model, laughing)), still)


def test_light_is_estimated_from_what_hair_leaves_of_the_face(head, model):
    look, identity = look_of(FRINGE), find_character(FRINGE).identity
    parameters, person = facing(10.0, identity), load_default_head().personal(identity)
    size = (240, 240)
    camera = Camera(*(np.asarray(part, np.float32) for part in camera_from_fov(size, 26.0)))
    vertices = np.asarray(face_vertices(model, parameters))
    albedo = vertex_colors(look.texture, person)
    photo = np.array(
        render(vertices, model.topology, camera, albedo, LIGHT, GREY, size=size, antialias=False).color, float
    )
    hidden = np.asarray(hidden_pixels(look.cover, model, parameters, camera, size=size))
    photo[hidden] = (0.1, 0.9, 0.1)
    known = known_appearance(photo, person, vertices, camera, albedo, hidden)
    assert known.residual < 0.01
    # Directions that the face shows little of are left to the ridge.
    np.testing.assert_allclose(known.light[:4], LIGHT[:4], atol=0.12)
    unaware = known_appearance(photo, person, vertices, camera, albedo)
    assert unaware.residual > 5.0 * known.residual


def character_config(name):
    return preset("deep").changed(deep={"appearance": "character"}, head={"character": name})


def test_a_solve_compares_renders_of_the_character(head):
    fitter = DeepFitter(head, plan_of(character_config(FRINGE)))
    light = Appearance(np.zeros((len(head.neutral), 3)), LIGHT, np.zeros(len(head.neutral)), 0.0)
    scene = fitter.scene(light)
    assert isinstance(scene.albedo, Texture)
    assert scene.cover is not None
    fitter.configure(plan_of(preset("deep")))
    assert fitter.scene(light).cover is None
    np.testing.assert_array_equal(fitter.scene(light).albedo, light.albedo)


def test_fits_depend_on_a_character_where_renders_show_it():
    assert fits_key(character_config("mei")) != fits_key(character_config("kofi"))
    deep = preset("deep")
    assert fits_key(deep.changed(head={"character": "mei"})) == fits_key(deep)
    face_it = preset("joint").changed(deep={"appearance": "character"})
    assert fits_key(face_it.changed(head={"character": "mei"})) == fits_key(face_it)
    assert plan_of(face_it).look is None


def test_a_character_that_is_written_again_is_shown_as_it_is_now(tmp_path):
    file, config = tmp_path / "me.toml", character_config(str(tmp_path / "me.toml"))
    shown = []
    for written, skin in enumerate((find_character(FRINGE).skin, find_character(BALD).skin)):
        identity = np.zeros(50).tolist()
        file.write_text(
            f'[me]\nwords = "me"\nskin = "{skin}"\neyes = "brown"\nbrows = ""\nlashes = "eyelashes01"\n'
            f'teeth = "teeth_base"\nidentity = {identity}\n'
        )
        os.utime(file, (written, written))
        shown.append(plan_of(config).look.texture.picture)
    assert np.abs(np.asarray(shown[0]) - np.asarray(shown[1])).max() > 0.1


def test_a_character_on_another_model_is_refused(head):
    other = replace(head, name="other")
    with pytest.raises(ModelError, match=r"default head.*other.*deep\.appearance"):
        DeepFitter(other, plan_of(character_config("mei")))
