"""One performance on other characters: by names, by a mapping file, by the surface."""

from dataclasses import replace

import numpy as np
import pytest

from tests.other_heads import half_open
from tests.performances import FRAMES, GAP, looking_aside, other_character, performance, with_jaw
from workbench.errors import InputError, ModelError
from workbench.export import make_clip, mapping_by_names, read_mapping, retarget, retarget_surface
from workbench.face import GAZE_NAMES, USUAL_JAW, in_scheme, load_default_head, principal_expressions
from workbench.landmarks.schemes import DENSE
from workbench.tracking.track_layout import model_record

IDENTITY = np.random.default_rng(8).normal(0.0, 1.2, 50)


@pytest.fixture(scope="module")
def character(head):
    return other_character(head, IDENTITY)


@pytest.fixture(scope="module")
def track(head):
    return performance(head)


def column(track, name):
    return track.expression[:, track.expression_names.index(name)]


def renamed(model, names):
    return replace(model, expression_names=tuple(names))


# --- by names ---


def test_a_character_of_another_shape_and_topology_plays_the_track(track, character, head):
    assert len(character.neutral) < 0.6 * len(head.neutral)
    played = retarget(track, character)
    np.testing.assert_array_equal(column(played, "jawOpen"), column(track, "jawOpen"))
    clip = make_clip(played, character)
    mouth = clip.person.landmarks.of(clip.vertices_head(FRAMES - 1))[[62, 66]]
    closed = clip.person.landmarks.of(clip.person.neutral)[[62, 66]]
    assert mouth[1, 1] - mouth[0, 1] > closed[1, 1] - closed[0, 1] + 8.0  # millimetres down


def test_the_pose_and_the_gaps_are_the_performers(track, character):
    played = retarget(track, character)
    np.testing.assert_array_equal(played.rotation, track.rotation)
    assert np.isnan(played.expression[GAP]).all()
    assert played.identity.shape == (FRAMES, 0)
    assert played.meta["model"]["name"] == "other"
    assert played.meta["retargeted_from"]["name"] == "default-head"
    assert track.meta["model"]["name"] == "default-head"


def test_a_character_without_a_jaw_joint_opens_the_mouth_by_its_blendshape(track, character):
    played = retarget(with_jaw(track), character)
    assert column(played, "jawOpen")[-1] == pytest.approx(0.6 + 24.0 / USUAL_JAW.open_deg)
    assert not played.jaw.any()


def test_a_jaw_joint_counts_in_the_jaw_shapes_of_the_model_that_was_tracked(track, character, head):
    narrow = half_open(head)
    of_narrow = replace(with_jaw(track), meta={**track.meta, "model": model_record(narrow)})
    opened = 0.6 + 24.0 / narrow.jaw_unit.open_deg
    assert column(retarget(of_narrow, character), "jawOpen")[-1] == pytest.approx(opened)
    older = replace(of_narrow, meta={**track.meta, "model": {"name": "flame", "sha256": "0"}})
    assert column(retarget(older, character), "jawOpen")[-1] == pytest.approx(0.6 + 24.0 / USUAL_JAW.open_deg)


@pytest.mark.parametrize(
    "spelling",
    [
        lambda name: name[0].upper() + name[1:],
        lambda name: "Face." + name,
        lambda name: name.replace("Left", "_L").replace("Right", "_R"),
        lambda name: name.replace("Left", "_left").replace("Right", "_right"),
        lambda name: "".join("_" + letter.lower() if letter.isupper() else letter for letter in name),
        lambda name: name.upper() if not name.endswith(("Left", "Right")) else name,
    ],
)
def test_spellings_of_the_same_names_are_recognised(spelling, head):
    names = head.expression_names
    mapping = mapping_by_names(names, tuple(spelling(name) for name in names))
    np.testing.assert_array_equal(mapping.matrix, np.eye(len(names)))
    assert mapping.unused == mapping.still == ()


def test_names_without_a_counterpart_are_told(head):
    mapping = mapping_by_names(head.expression_names, ("jawOpen", *GAZE_NAMES))
    assert mapping.still == GAZE_NAMES
    assert len(mapping.unused) == len(head.expression_names) - 1


def test_a_character_with_no_name_in_common_is_refused(track, character):
    strange = renamed(character, [f"shape{k}" for k in range(44)])
    with pytest.raises(InputError, match="write a mapping file"):
        retarget(track, strange)


def test_components_of_another_basis_are_not_the_same_for_their_names(head):
    principal = principal_expressions(head, 3)
    numbered = principal.expression_names
    with pytest.raises(InputError, match="write a mapping file"):
        mapping_by_names(numbered, numbered)
    mapping = mapping_by_names(("jawOpen", *numbered), (*numbered, "jawOpen"))
    assert mapping.still == numbered


def test_the_model_that_was_tracked_plays_its_own_components(head):
    principal = principal_expressions(head, 3)
    rng, names = np.random.default_rng(0), principal.expression_names
    own = performance(head, frames=2, gap=None)
    meta = {**own.meta, "expression_names": list(names), "model": model_record(principal)}
    own = replace(own, expression=rng.normal(size=(2, 3)), meta=meta)
    np.testing.assert_array_equal(retarget(own, principal).expression, own.expression)
    with pytest.raises(InputError, match="write a mapping file"):
        retarget(own, replace(principal, expression_deltas=principal.expression_deltas[::-1]))


# --- by a mapping file ---


def test_a_mapping_file_sums_and_scales(track, character, tmp_path):
    (tmp_path / "map.toml").write_text(
        '[shapes]\nOpen = "jawOpen"\nSmile = { mouthSmileLeft = 0.5, mouthSmileRight = 0.5 }\nLook = "eyeLookUpLeft"\n'
    )
    names = ("Open", "Smile", "Look", "Other")
    small = replace(character, expression_names=names, expression_deltas=character.expression_deltas[:4])
    mapping = read_mapping(tmp_path / "map.toml", track.expression_names, names)
    played = retarget(track, small, mapping)
    np.testing.assert_array_equal(column(played, "Open"), column(track, "jawOpen"))
    np.testing.assert_allclose(column(played, "Smile"), 0.5 * column(track, "mouthSmileLeft"))
    assert mapping.still == ("Look", "Other")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "does not exist"),
        ("[shapes", "is not valid TOML"),
        ("Open = 'jawOpen'", r"needs a table \[shapes\]"),
        ("[shapes]\nMouth = 'jawOpen'", "names 'Mouth', the character has Open"),
        ("[shapes]\nOpen = 'jawOpenn'", "names 'jawOpenn', the track has"),
        ("[shapes]\nOpen = { jawOpen = 'much' }", "a name or a table of names with factors"),
        ("[shapes]\nOpen = 3", "a name or a table of names with factors"),
    ],
)
def test_mapping_files_that_cannot_be_used_are_refused(text, message, track, tmp_path):
    path = tmp_path / "map.toml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_mapping(path, track.expression_names, ("Open",))


def test_a_mapping_for_another_character_is_refused(track, character):
    mapping = mapping_by_names(track.expression_names, ("jawOpen",))
    with pytest.raises(InputError, match="other blendshapes"):
        retarget(track, character, mapping)


# --- by the surface ---


def test_the_same_shapes_under_other_names_get_the_same_weights(track, head):
    ours = head.personal(track.identity[0])
    twin = renamed(ours, [f"shape{k}" for k in range(44)])
    played = retarget_surface(track, head, twin, smoothness=1e-9)
    found = track.found
    # What no vertex tells apart stays open, so the surfaces are compared and not the weights.
    for position in np.flatnonzero(found)[::3]:
        moved = twin.vertices(played.expression[position]) - ours.vertices(track.expression[position])
        assert np.abs(moved).max() < 0.1


def test_a_character_whose_shapes_travel_half_as_far_opens_twice_as_much(track, head):
    half = replace(head.personal(track.identity[0]), expression_deltas=0.5 * head.expression_deltas)
    played = retarget_surface(track, head, half, smoothness=1e-6)
    # 0.6 of our jaw is 1.2 of theirs, and weights end at 1.
    assert column(played, "jawOpen")[-1] == pytest.approx(1.0, abs=0.02)
    middle = int(np.nanargmin(np.abs(column(track, "jawOpen") - 0.3)))
    assert column(played, "jawOpen")[middle] == pytest.approx(2.0 * column(track, "jawOpen")[middle], abs=0.05)
    assert np.nanmin(played.expression) >= 0.0


def test_further_landmarks_change_no_weight(track, head):
    dense = in_scheme(load_default_head(gaze=True), DENSE)
    clip = looking_aside()
    plain, further = (retarget_surface(clip.track, each, head) for each in (load_default_head(gaze=True), dense))
    np.testing.assert_allclose(further.expression, plain.expression, atol=1e-9)


def test_a_shape_that_cannot_move_keeps_its_weight(track, head):
    bounds = np.tile([0.0, 1.0], (44, 1))
    jaw, brow = (head.expression_names.index(name) for name in ("jawOpen", "browInnerUp"))
    bounds[brow] = 0.3
    played = retarget_surface(track, head, replace(head, expression_range=bounds))
    assert (played.expression[track.found, brow] == 0.3).all()
    free = retarget_surface(track, head, head)
    np.testing.assert_allclose(played.expression[:, jaw], free.expression[:, jaw], atol=0.01)
    bounds[:] = 0.0
    still = retarget_surface(track, head, replace(head, expression_range=bounds))
    assert (still.expression[track.found] == 0.0).all()
    assert np.isnan(still.expression[GAP]).all()


def test_a_surface_without_correspondence_is_refused(track, head, character):
    with pytest.raises(ModelError, match="same vertices and triangles"):
        retarget_surface(track, head, character)


def test_a_track_without_a_face_has_nothing_to_retarget(track, head):
    empty = replace(track, found=np.zeros(FRAMES, bool))
    with pytest.raises(InputError, match="nothing to retarget"):
        retarget_surface(empty, head, head)
