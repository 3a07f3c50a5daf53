"""Characters on the default head: parts follow it, the head stays as it was, and what is wrong is said."""

import hashlib
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from tests.optional_parts import needs_gl
from tests.pages import code_blocks, snippet
from tests.performances import performance
from workbench.config import config_of_track, preset
from workbench.errors import ConfigError, InputError, ModelError
from workbench.export import export_track
from workbench.face import (
    DressedHead,
    FaceParameters,
    character_names,
    dressed_as,
    find_character,
    in_scheme,
    load_character,
    load_default_head,
    posed_vertices,
)
from workbench.face.characters import lasting_name
from workbench.face.dressed_head import dress
from workbench.face.parts import open_parts
from workbench.frames import write_picture
from workbench.landmarks.schemes import DENSE
from workbench.pictures import HeadRenderer, head_scene, portrait_view, worn_parts
from workbench.pictures.extras import NOTHING, Extras
from workbench.pictures.neck import bent, neck_of
from workbench.samples import sample

PEOPLE = Path(__file__).parents[1] / "data_samples" / "head" / "people"
HEAD_ARRAYS = "b9e91ec1c27d22fb86bd2efaba05950aae854afd49c95f7ec0dca7200d07764b"
LANDMARK_MOTIONS = "dd80faad7bb4de2cef4794533326ff6d5cfe2247a6ed62799f3bd63323d736d7"
"""Of the first head, whose smile had a ridge beside the mouth, as well."""
KINDS = ("tongue", "teeth", "eyes", "corneas", "brows", "lashes")


@lru_cache
def dressed(name: str) -> DressedHead:
    return load_character(name)


def parameters(head: DressedHead, jaw=(), identity=None, scale=(), **weights: float) -> FaceParameters:
    expression = np.zeros(len(head.model.expression_names))
    for name, weight in weights.items():
        expression[head.model.expression_names.index(name)] = weight
    identity = np.zeros(0) if identity is None else identity
    return FaceParameters(np.zeros(3), np.zeros(3), expression, identity, np.array(jaw, float), np.array(scale, float))


def part(head: DressedHead, kind: str, **how) -> np.ndarray:
    index = [worn.part.kind for worn in head.worn].index(kind)
    return head.part_vertices(parameters(head, **how))[index]


def rows_of(head: DressedHead, kind: str, region: str) -> np.ndarray:
    """Vertices of a part that are tied to a region of the head."""
    worn = next(worn.part for worn in head.worn if worn.part.kind == kind)
    return np.isin(worn.anchors[:, 0], head.model.regions[region])


def test_the_heads_geometry_is_the_one_that_tracks_were_made_with():
    with np.load(sample("head")) as stored:
        digest = hashlib.sha256()
        for name in sorted(stored.files):
            digest.update(name.encode() + np.ascontiguousarray(stored[name]).tobytes())
    assert digest.hexdigest() == HEAD_ARRAYS
    assert load_character("mei").model.fingerprint() == load_default_head(gaze=True).fingerprint()


def test_a_fit_without_the_eyes_units_wears_the_same_parts():
    head = dressed("mei")
    names = load_default_head().expression_names
    fitted = parameters(head)._replace(expression=np.array([0.7 * (name == "jawOpen") for name in names]))
    for mine, theirs in zip(head.part_vertices(fitted), head.part_vertices(parameters(head, jawOpen=0.7)), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    with pytest.raises(InputError, match="has 52 blendshapes, 44 without the eyes' units, got 10 weights"):
        head.vertices(fitted._replace(expression=np.zeros(10)))


@pytest.mark.parametrize("suffix", [".glb", ".usd"])
def test_another_model_is_not_exported_as_a_character(suffix, tmp_path):
    head = load_default_head()
    other = replace(head, name="other")
    with pytest.raises(ModelError, match="Characters are for the default head, this is the model other"):
        export_track(performance(other), other, tmp_path / f"x{suffix}", dressed=dressed("mei"))
    assert not list(tmp_path.iterdir())


def test_landmarks_move_as_they_did_when_a_smile_had_a_ridge():
    """All that a fit to the 68 points, the jaw's contour or the dense points knows of a head: bit by bit."""
    model, digest = in_scheme(load_default_head(gaze=True), DENSE), hashlib.sha256()
    for shapes in (model.neutral, model.expression_deltas, model.identity_deltas):
        for points in (model.landmarks, model.contour):
            digest.update(np.ascontiguousarray(points.of(shapes)).tobytes())
    assert digest.hexdigest() == LANDMARK_MOTIONS


def test_there_are_many_and_they_differ():
    names = character_names()
    people = [find_character(name) for name in names]
    assert len(names) >= 8
    assert len({person.skin for person in people}) >= 6
    assert len({person.hair for person in people}) >= 5
    assert len({person.eyes for person in people}) >= 4
    apart = [np.linalg.norm(a.identity - b.identity) for k, a in enumerate(people) for b in people[:k]]
    assert min(apart) > 1.0


@pytest.mark.parametrize("name", character_names())
def test_every_character_is_complete(name):
    head = dressed(name)
    assert {worn.part.kind for worn in head.worn} >= set(KINDS)
    for worn, points in zip(head.worn, head.part_vertices(parameters(head)), strict=True):
        assert points.shape == (len(worn.part.offsets), 3)
        assert np.isfinite(points).all()
        np.testing.assert_allclose(worn.part.weights.sum(axis=1), 1.0, atol=0.02)


def test_everything_of_the_package_is_small():
    assert sum(path.stat().st_size for path in PEOPLE.rglob("*") if path.is_file()) <= 10_000_000


def test_lower_teeth_go_with_the_jaw_and_upper_teeth_stay():
    head = dressed("bruno")
    lower, upper = (rows_of(head, "teeth", region) for region in ("teethL", "teethU"))
    assert lower.sum() > 1000
    assert upper.sum() > 1000
    mean = np.zeros(50)
    rest = part(head, "teeth", identity=mean)
    for how in ({"jawOpen": 1.0}, {"jaw": (np.radians(24.0), 0, 0, 0, 0, 0)}):
        moved = part(head, "teeth", identity=mean, **how) - rest
        assert np.linalg.norm(moved[upper], axis=1).max() < 0.5
        assert 15.0 < np.median(moved[lower][:, 1]) < 35.0
        # A jaw is one bone: distances within it stay, up to the size of the teeth that the unit was made with.
        rows = np.flatnonzero(lower)[[0, 400, 900, 1500]]
        before, after = (np.linalg.norm(points[rows[1:]] - points[rows[0]], axis=1) for points in (rest, rest + moved))
        np.testing.assert_allclose(after, before, rtol=0.02)


def test_lashes_go_down_with_the_upper_lid():
    head = dressed("amara")
    moved = part(head, "lashes", eyeBlinkLeft=1.0) - part(head, "lashes")
    left = part(head, "lashes")[:, 0] > 0
    assert moved[left][:, 1].max() > 4.0
    assert np.abs(moved[~left]).max() < 0.1


def test_brows_follow_the_forehead_and_hair_does_not():
    head = dressed("mei")
    assert part(head, "brows", browInnerUp=1.0)[:, 1].mean() < part(head, "brows")[:, 1].mean() - 1.0
    np.testing.assert_array_equal(part(head, "hair", browInnerUp=1.0, jawOpen=1.0), part(head, "hair"))


@pytest.mark.parametrize("name", character_names())
def test_worn_brows_lie_on_the_landmarks_of_brows(name):
    head = dressed(name)
    worn = next(worn for worn in head.worn if worn.part.kind == "brows")
    corners, where = worn.part.triangles, worn.part.uv[worn.part.triangles_uv].mean(axis=1)
    height, width = worn.picture.shape[:2]
    alpha = worn.picture[((1 - where[:, 1]) * height).astype(int), (where[:, 0] * width).astype(int), 3]
    for sights in ({}, {"browInnerUp": 1.0}, {"browDownLeft": 1.0, "browDownRight": 1.0}, {"eyeBlinkLeft": 1.0}):
        hair = part(head, "brows", **sights)[corners[alpha >= 100]].mean(axis=1)
        own = head.model.landmarks.of(head.vertices(parameters(head, **sights)))[17:27]
        for side, line in ((hair[:, 0] < 0, own[:5]), (hair[:, 0] > 0, own[5:])):
            within = side & (hair[:, 0] > line[0, 0]) & (hair[:, 0] < line[-1, 0])
            below = hair[within, 1] - np.interp(hair[within, 0], line[:, 0], line[:, 1])
            assert within.sum() > 8
            assert abs(below.mean()) < 1.5


def test_worn_brows_lie_just_before_the_skin():
    head = dressed("walter")
    brows = next(worn.part for worn in head.worn if worn.part.kind == "brows")
    for sights in ({}, {"browInnerUp": 1.0}, {"browDownLeft": 1.0}, {"eyeBlinkLeft": 1.0}, {"noseSneerLeft": 1.0}):
        vertices, points = head.vertices(parameters(head, **sights)), part(head, "brows", **sights)
        skin = np.einsum("nk,nkd->nd", brows.weights, vertices[brows.anchors])
        assert np.linalg.norm(points - skin, axis=1).max() < 1.0
        middles = points[brows.triangles].mean(axis=1)
        corners = vertices[head.model.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        seen = np.flatnonzero((normals[:, 2] < 0) & np.isin(head.model.triangles, brows.anchors).any(axis=1))
        # A ray from a middle along the depth goes through the skin behind it.
        first, edges = corners[seen, 0, :2], np.stack([corners[seen, k, :2] - corners[seen, 0, :2] for k in (1, 2)], 2)
        share = np.einsum("tij,ntj->nti", np.linalg.inv(edges), middles[:, None, :2] - first)
        share = np.concatenate([1 - share.sum(axis=2, keepdims=True), share], axis=2)
        depth = np.einsum("ntk,tk->nt", share, corners[seen, :, 2])
        hit = (share >= 0).all(axis=2)
        assert hit.any(axis=1).mean() > 0.99
        assert (np.where(hit, depth, np.inf).min(axis=1) > middles[:, 2])[hit.any(axis=1)].all()


def test_eyeballs_turn_without_changing_their_shape():
    head = dressed("mei")
    rest, turned = part(head, "eyes"), part(head, "eyes", eyeLookOutLeft=1.0, eyeLookInRight=1.0)
    for side in (rest[:, 0] > 0, rest[:, 0] < 0):
        before, after = (np.linalg.norm(points[side] - points[side][0], axis=1) for points in (rest, turned))
        np.testing.assert_allclose(after, before, atol=0.8)
    front = rest[:, 2].argmin()
    assert turned[front, 0] - rest[front, 0] > 2.0


def test_hair_follows_the_identity_and_the_scale():
    head = dressed("bruno")
    mean = part(head, "hair", identity=np.zeros(50))
    assert np.abs(part(head, "hair") - mean).max() > 2.0
    np.testing.assert_allclose(part(head, "hair", scale=(2.0,)), 2.0 * part(head, "hair"), atol=1e-6)
    np.testing.assert_allclose(part(head, "brows", scale=(2.0,)), 2.0 * part(head, "brows"), atol=1e-6)


def test_offsets_of_the_head_carry_over_to_blendshapes_of_the_parts():
    head = dressed("bruno")
    worn = next(worn.part for worn in head.worn if worn.part.kind == "brows")
    shape = head.model.expression_names.index("browInnerUp")
    carried = worn.carried(head.model.expression_deltas[shape : shape + 1])[0]
    moved = part(head, "brows", browInnerUp=1.0) - part(head, "brows")
    np.testing.assert_allclose(carried, moved, atol=1e-9)


def test_upper_incisors_are_inside_the_closed_lips():
    for name in character_names():
        head = dressed(name)
        teeth = part(head, "teeth")
        seam = head.person.landmarks.of(head.person.neutral)[60:68]
        front = teeth[(np.abs(teeth[:, 0]) < 8)][:, 2].min()
        assert front > seam[:, 2].min() + 1.0, name


def test_unknown_names_are_answered_with_those_there_are():
    with pytest.raises(ModelError, match=r"no character 'nobody'; there are amara, bruno"):
        load_character("nobody")
    with pytest.raises(ModelError, match=r"no style 'mohawk' for hair; the styles are afro01"):
        open_parts(sample("parts")).read("hair", "mohawk", 4823)


WHOLE = (
    '[me]\nwords = "me"\nskin = "young_lightskinned_male"\neyes = "blue"\nbrows = "eyebrow001"\n'
    f'lashes = "eyelashes01"\nteeth = "teeth_base"\nidentity = [{", ".join(["0.0"] * 50)}]\n'
)


def test_a_character_of_ones_own_is_read(tmp_path):
    path = tmp_path / "me.toml"
    path.write_text(WHOLE + "skin_shift = [-10, 2, 3]\n")
    head = load_character(path)
    assert head.character.name == "me"
    assert head.skin.mean() < load_character("bruno").skin.max()
    assert "hair" not in [worn.part.kind for worn in head.worn]
    brighter = tmp_path / "brighter.toml"
    brighter.write_text(WHOLE)
    assert head.skin.mean() < load_character(brighter).skin.mean() - 10


def test_the_scalp_takes_the_colour_of_the_hair(tmp_path):
    path = tmp_path / "me.toml"
    path.write_text(WHOLE)
    bald = load_character(path)
    path.write_text(WHOLE + 'hair = "short02"\nhair_color = [30, 30, 200]\n')
    blue = load_character(path)
    changed = np.abs(blue.skin.astype(int) - bald.skin).max(axis=2) > 20

    def there(region: str) -> np.ndarray:
        inside = np.zeros(len(bald.model.neutral), bool)
        inside[bald.model.regions[region]] = True
        triangles = bald.model.triangles_uv[inside[bald.model.triangles].all(axis=1)]
        column, row = (bald.model.uv[triangles].mean(axis=1) * [1, -1] + [0, 1]).T * len(changed)
        return changed[row.astype(int), column.astype(int)]

    assert there("scalp").mean() > 0.9
    assert there("lips").mean() == there("brow").mean() == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("", ""), None),
        (('eyes = "blue"\n', ""), "eyes is missing"),
        (('eyes = "blue"', "eyes = 3"), "eyes needs text"),
        (('eyes = "blue"', 'eyes = "violet"'), "no style 'violet' for eyes; the styles are blue"),
        (('skin = "young_lightskinned_male"', 'skin = "../head"'), "no skin '../head'; the skins are"),
        (('brows = "eyebrow001"', 'brows = "eyebrow999"'), "no style 'eyebrow999' for brows"),
        (('words = "me"', 'words = "me"\nhat = "top"'), "no setting 'hat'"),
        (('words = "me"', 'words = "me"\nhair_color = [300, 0, 0]'), "3 numbers from 0 to 255"),
        (('words = "me"', 'words = "me"\nhair_color = [3, 0]'), "3 numbers from 0 to 255"),
        (("identity = [0.0, ", "identity = ["), "49 identity coefficients"),
        (("identity = [0.0, ", "identity = [nan, "), "a list of numbers from -6 to 6"),
        (("[me]", "[me"), "not valid TOML"),
    ],
)
def test_what_is_wrong_with_a_character_is_said(tmp_path, change, message):
    path = tmp_path / "me.toml"
    path.write_text(WHOLE.replace(*change) if change[0] else WHOLE)
    if message is None:
        load_character(path)
        return
    with pytest.raises(ModelError, match=message.replace("[", r"\[")):
        load_character(path)


def test_a_file_without_a_character_is_refused(tmp_path):
    path = tmp_path / "none.toml"
    path.write_text("# nobody yet\n")
    with pytest.raises(ModelError, match="holds no character"):
        load_character(path)
    path.write_text("me = 3\n")
    with pytest.raises(ModelError, match="expected a table of settings"):
        load_character(path)


def test_a_skin_may_be_wider_than_high_and_its_scalp_takes_the_colour_of_the_hair(tmp_path):
    whole = np.full((256, 256, 3), 200, np.uint8)
    found = []
    for name, picture in (("square", whole), ("wide", np.full((256, 512, 3), 200, np.uint8))):
        write_picture(tmp_path / f"{name}.png", picture)
        person = replace(find_character("mei"), skin=str(tmp_path / f"{name}.png"), hair_color=(40.0, 20.0, 10.0))
        found.append(dress(person).skin)
        assert found[-1].shape == picture.shape
    halved = cv2.resize(found[1], (256, 256), interpolation=cv2.INTER_AREA).astype(int)
    assert found[0].min() < 120
    assert np.abs(halved - found[0]).mean() < 1.0


def test_damaged_parts_are_refused(tmp_path):
    with np.load(sample("parts")) as stored:
        arrays = {name: stored[name] for name in stored.files if "eyebrow001" in name or "." not in name}
    path = tmp_path / "parts.npz"
    for name, damage in (
        ("anchors", lambda array: array + 5000),
        ("offsets", lambda array: array[:-1]),
        ("triangles", lambda array: array + 200),
        ("weights", lambda array: np.full_like(array, np.nan)),
    ):
        key = f"brows.eyebrow001.{name}"
        np.savez(path, **(arrays | {key: damage(arrays[key])}))
        with pytest.raises(ModelError, match=rf"brows eyebrow001 \({name}\)"):
            open_parts(path).read("brows", "eyebrow001", 4823)
    path.write_bytes(b"no archive")
    with pytest.raises(ModelError, match="cannot be read as parts of a head"):
        open_parts(path)
    with pytest.raises(ModelError):
        open_parts(tmp_path / "missing.npz")


def test_a_configuration_names_a_character_that_is_there():
    assert preset("joint").head.character == "plain"
    assert preset("joint").changed(head={"character": "mei"}).head.character == "mei"
    assert preset("joint").changed(head={"character": "own.toml"}).head.character == "own.toml"
    with pytest.raises(ConfigError, match=r"no character or file 'nobody'; name a ready one \(plain, amara"):
        preset("joint").changed(head={"character": "nobody"})


def test_a_character_of_ones_own_is_stored_under_a_name_that_holds_everywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "me").mkdir()
    (tmp_path / "mei").mkdir()
    assert lasting_name("me") == str(tmp_path / "me")
    assert [lasting_name(name) for name in ("plain", "mei", "gone.toml")] == ["plain", "mei", "gone.toml"]


def test_a_stored_character_that_is_gone_is_plain_unless_fits_depend_on_it():
    for name in ("gone", "gone.toml"):
        stored = preset("joint").model_dump(mode="json") | {"head": {"character": name}}
        assert config_of_track({"config": stored}).head.character == "plain"
    assert config_of_track({}) is None
    deep = preset("deep").changed(deep={"appearance": "character"}, head={"character": "mei"}).model_dump(mode="json")
    with pytest.raises(ConfigError, match="no character or file 'gone'"):
        config_of_track({"config": deep | {"head": {"character": "gone"}}})


def test_another_model_cannot_be_dressed():
    head = load_default_head()
    assert dressed_as("plain", head) is None
    assert dressed_as("mei", head).character.name == "mei"
    with pytest.raises(ModelError, match="this is the model flame; leave the character at 'plain'"):
        dressed_as("mei", replace(head, name="flame"))


def test_the_guides_own_person_is_one(tmp_path):
    (written,) = (text for page, text in code_blocks("toml") if page.endswith("characters.md"))
    path = tmp_path / "me.toml"
    path.write_text(written)
    assert load_character(path).character.clothes == "shirt"


def test_the_guides_python_draws_a_person():
    names: dict = {}
    exec(compile(snippet("load_character"), "documentation", "exec"), names)
    assert names["picture"].shape == (480, 480, 3)


def drawn(head: DressedHead, size: int = 160, **weights: float) -> np.ndarray:
    person = head.person
    camera, translation = portrait_view(person, (size, size))
    with HeadRenderer(person, (size, size), supersampling=1.0, dressed=head) as renderer:
        vertices = posed_vertices(person, parameters(head, **weights).expression, np.zeros(6))
        return renderer.render(vertices, camera, np.zeros(3), translation, background=(0, 0, 255)).astype(int)


@needs_gl
def test_hair_is_drawn_over_the_crown():
    head = dressed("edda")
    bald = replace(head, worn=tuple(worn for worn in head.worn if worn.part.kind != "hair"))
    with_hair, without = drawn(head), drawn(bald)
    crown = (slice(0, 50), slice(40, 120))
    assert np.abs(with_hair[crown] - without[crown]).mean() > 10
    below = (slice(100, 120), slice(70, 90))
    assert np.abs(with_hair[below] - without[below]).mean() < 2


@needs_gl
@pytest.mark.parametrize("name", ["amara", "mei"])
def test_a_few_layers_of_strands_look_like_all_of_them(monkeypatch, name):
    """Dense strands are drawn as opaque, which leaves few layers to blend; blending all of them looks the same."""
    quick = drawn(dressed(name))
    monkeypatch.setattr(head_scene, "PEELS", 16)
    monkeypatch.setattr(worn_parts, "DENSE_ALONE", "//VTK::TCoord::Impl\n  discard;\n")
    apart = np.abs(quick - drawn(dressed(name))).max(axis=-1)
    assert np.mean(apart > 8) < 0.002


@needs_gl
def test_hair_follows_the_person_that_a_picture_is_of():
    head, size = dressed("kofi"), 120
    person = head.model.personal(np.linspace(-2.0, 2.0, 50))
    camera, translation = portrait_view(person, (size, size))
    view = (camera, np.zeros(3), translation, (0, 0, 255))
    pictures = []
    for model, extras in ((person, NOTHING), (head.model, Extras(rest=person.neutral)), (head.model, NOTHING)):
        with HeadRenderer(model, (size, size), supersampling=1.0, dressed=head) as renderer:
            pictures.append(renderer.render(person.neutral, *view, extras=extras).astype(int))
    assert np.abs(pictures[1] - pictures[0]).mean() < 0.1
    assert np.abs(pictures[2] - pictures[0]).mean() > 0.5


@needs_gl
def test_a_smile_shows_teeth():
    smile = {"mouthSmileLeft": 0.9, "mouthSmileRight": 0.9, "jawOpen": 0.3, "mouthUpperUpLeft": 0.5}
    head = dressed("thabo")
    closed, smiling = drawn(head), drawn(head, mouthUpperUpRight=0.5, **smile)
    mouth = (slice(100, 130), slice(55, 105))
    assert smiling[mouth].mean(axis=2).max() > closed[mouth].mean(axis=2).max() + 40


@needs_gl
def test_eyes_have_a_highlight():
    picture = drawn(dressed("mei"), size=320)
    eyes = picture[130:175, 80:240]
    assert (eyes.min(axis=2) > 235).any()


@needs_gl
def test_only_the_default_head_can_be_dressed():
    other = SimpleNamespace(neutral=np.zeros((4824, 3)))
    with pytest.raises(InputError, match="4823 vertices, got a model with 4824"):
        HeadRenderer(other, (32, 32), dressed=dressed("mei"))


def test_a_neck_bends_between_head_and_body():
    head = dressed("mei")
    rest = head.person.neutral
    neck = neck_of(head.model, rest)
    turned, body = np.array([0.1, 0.6, 0.2]), np.array([0.04, 0.24, 0.08])
    moved = bent(rest, rest[:, 1], neck, turned, body)
    above = rest[:, 1] <= neck.chin
    np.testing.assert_array_equal(moved[above], rest[above])
    landmarks = head.person.landmarks
    np.testing.assert_array_equal(landmarks.of(moved), landmarks.of(rest))
    shoulder = np.array([[150.0, 260.0, 120.0]])
    towards_camera = (bent(shoulder, shoulder[:, 1], neck, turned, body) - neck.pivot) @ _matrix(turned).T
    np.testing.assert_allclose(towards_camera, (shoulder - neck.pivot) @ _matrix(body).T, atol=1e-9)
    np.testing.assert_array_equal(bent(rest, rest[:, 1], neck, turned, turned), rest)


def _matrix(vector: np.ndarray) -> np.ndarray:
    return cv2.Rodrigues(vector)[0]


@needs_gl
def test_a_body_that_stays_is_drawn_so():
    head, size = dressed("walter"), 160
    person = head.person
    camera, translation = portrait_view(person, (size, size))
    turned = np.array([0.0, 0.6, 0.0])
    with HeadRenderer(person, (size, size), supersampling=1.0, dressed=head) as renderer:
        whole, bending = (
            renderer.render(person.neutral, camera, turned, translation, (0, 0, 255), extras=Extras(body=body))
            for body in (None, np.zeros(3))
        )
    changed = np.abs(whole.astype(int) - bending).mean(axis=2)
    chin = round(size * 0.85)
    assert changed[chin:].mean() > 5.0
    assert changed[: size // 2].mean() < 0.5
