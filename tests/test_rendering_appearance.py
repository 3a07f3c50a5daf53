"""Albedo and light from one picture: what is found again, what is left out, what is stored."""

import os
from dataclasses import replace

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.face import FaceParameters
from workbench.geometry import camera_from_fov
from workbench.rendering import (
    ambient_light,
    directional_light,
    estimate_appearance,
    face_vertices,
    load_appearance,
    render,
    render_model,
    shading,
)

SIZE = (160, 160)
LIGHT = ambient_light((0.45, 0.42, 0.4)) + directional_light((-0.8, -0.5, -1.0), (0.6, 0.55, 0.5))


def picture_of(model, vertices, camera, albedo, light):
    """The rendering that estimation starts from is compiled for these shapes anyway."""
    grey = np.zeros(3)
    return render(vertices, model.topology, camera, albedo, light, grey, size=SIZE, antialias=False)


@pytest.fixture(scope="module")
def scene(head):
    """A picture of the head with redder cheeks than the model's, and all that it was made of."""
    model = render_model(head)
    still = np.zeros(3), np.array([0.0, 20.0, 430.0]), np.zeros(len(head.expression_names)), np.zeros(0)
    vertices = np.asarray(face_vertices(model, FaceParameters(*still)), float)
    camera = camera_from_fov(SIZE, 30.0)
    albedo = np.array(model.colors, float)
    cheeks = (np.abs(np.abs(head.neutral[:, 0]) - 40.0) < 15.0) & (np.abs(head.neutral[:, 1] - 35.0) < 15.0)
    albedo[cheeks] *= [1.1, 0.8, 0.8]
    picture = picture_of(model, vertices, camera, albedo, LIGHT).color
    return head, model, vertices, camera, albedo, np.asarray(picture, float)


@pytest.fixture(scope="module")
def estimate(scene):
    head, _, vertices, camera, _, picture = scene
    return estimate_appearance(picture, head, vertices, camera)


def test_the_picture_is_reproduced(scene, estimate):
    head, model, vertices, camera, _, picture = scene
    again = picture_of(model, vertices, camera, estimate.albedo, estimate.light)
    face = np.asarray(again.triangle) >= 0
    skin = np.isin(np.asarray(model.topology.triangles)[np.asarray(again.triangle)], head.regions["skin"]).all(axis=-1)
    assert np.sqrt(((np.asarray(again.color) - picture)[face & skin] ** 2).mean()) < 0.02
    assert estimate.residual < 0.02


def test_the_light_is_found_up_to_the_scale_that_is_agreed(estimate):
    """Compared as what white surfaces show from the front hemisphere."""
    normals = np.random.default_rng(0).normal(size=(400, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals[normals[:, 2] < -0.5].T.astype(np.float32)
    truth, found = (np.stack(shading(light, tuple(normals))) for light in (LIGHT, estimate.light))
    scale = (truth * found).sum(axis=1, keepdims=True) / (found * found).sum(axis=1, keepdims=True)
    assert scale == pytest.approx(np.ones((3, 1)), abs=0.1)
    assert np.abs(scale * found - truth).mean() < 0.04


def test_seen_skin_keeps_the_mean_of_the_models_colours(scene, estimate):
    head = scene[0]
    face = np.zeros(len(head.neutral), bool)
    for name in ("skin", "lips", "brow"):
        face[head.regions[name]] = True
    seen = face & (estimate.seen > 0.5)
    assert estimate.albedo[seen].mean(axis=0) == pytest.approx(head.colors[seen].mean(axis=0) / 255.0, abs=0.02)


def test_red_cheeks_are_albedo_not_light(scene, estimate):
    head, albedo = scene[0], scene[4]
    changed = np.abs(albedo - head.colors / 255.0).max(axis=1) > 0.05
    changed &= estimate.seen > 0.5
    ratio = estimate.albedo[changed] / np.maximum(head.colors[changed] / 255.0, 1e-3)
    assert np.median(ratio[:, 0] / ratio[:, 1]) == pytest.approx(1.1 / 0.8, rel=0.15)


def test_a_half_hidden_face_is_filled_from_its_mirror_image_and_keeps_its_light(scene, estimate):
    """A dark microphone before the chin and hair over one temple: as outliers they hardly count."""
    head, _, vertices, camera, _, picture = scene
    covered = picture.copy()
    covered[118:145, 70:84] = 0.02
    covered[40:70, 45:60] = 0.05
    found = estimate_appearance(covered, head, vertices, camera)
    skin = np.zeros(len(head.neutral), bool)
    skin[head.regions["skin"]] = True
    skin &= estimate.seen > 0.5
    assert np.abs(found.albedo - estimate.albedo)[skin].mean() < 0.03
    assert np.percentile(np.abs(found.albedo - estimate.albedo)[skin].max(axis=1), 95) < 0.2


def test_eyes_and_hair_are_tinted_as_a_whole(scene):
    """Half as bright in the picture: the same factor for every vertex, whatever it shows."""
    head, model, vertices, camera, albedo, _ = scene
    darker = albedo.copy()
    for name in ("eyeL", "eyeR", "scalp"):
        darker[head.regions[name]] *= 0.5
    found = estimate_appearance(
        np.asarray(picture_of(model, vertices, camera, darker, LIGHT).color, float), head, vertices, camera
    )
    for name in ("eyeL", "eyeR", "scalp"):
        ratio = found.albedo[head.regions[name]] / (head.colors[head.regions[name]] / 255.0)
        assert np.ptp(ratio, axis=0) == pytest.approx(np.zeros(3), abs=1e-5)
        assert ratio.mean() == pytest.approx(0.5, abs=0.12)


def test_what_is_not_seen_keeps_the_models_colours(scene, estimate):
    """The mouth is closed."""
    head = scene[0]
    for name in ("teethU", "tongue", "mouth_cavity"):
        own = head.regions[name]
        assert estimate.albedo[own] == pytest.approx(head.colors[own] / 255.0, abs=1e-6)


def test_the_background_does_not_colour_ears_and_neck(scene, estimate):
    """A fit is never exact: here the picture shows the head 4 mm aside, before a background as bright as skin."""
    head, model, vertices, camera, albedo, _ = scene
    aside = vertices + np.array([4.0, 0.0, 0.0])
    shown = render(
        aside, model.topology, camera, albedo, LIGHT, np.array([0.5, 0.5, 0.6]), size=SIZE, antialias=False
    ).color
    found = estimate_appearance(np.asarray(shown, float), head, vertices, camera)
    beside = np.zeros(len(head.neutral), bool)
    beside[head.regions["skin"]] = True
    beside &= (head.neutral[:, 2] > 60.0) | (head.neutral[:, 1] > 125.0)
    assert np.abs(found.albedo - head.colors / 255.0)[beside].max() < 0.04


@pytest.mark.parametrize("named", [("skin", "lips", "brow", "scalp"), ("skin",), ()], ids=len)
def test_a_model_without_some_regions_has_its_skin_estimated_alike(scene, estimate, named):
    """Files of other models name neither eyes nor teeth, and some nothing at all."""
    head, _, vertices, camera, _, picture = scene
    fewer = replace(head, regions={name: head.regions[name] for name in named})
    found = estimate_appearance(picture, fewer, vertices, camera)
    skin = head.in_regions(("skin",)) & (estimate.seen > 0.5) & (found.seen > 0.5)
    assert skin.sum() > 0.9 * (head.in_regions(("skin",)) & (estimate.seen > 0.5)).sum()
    assert np.abs(found.albedo - estimate.albedo)[skin].mean() < 0.01


def test_an_appearance_is_stored_and_read_again(scene, estimate, tmp_path):
    head = scene[0]
    path = tmp_path / "actor.npz"
    estimate.save(path)
    again = load_appearance(path, head)
    assert np.array_equal(again.albedo, estimate.albedo)
    assert np.array_equal(again.light, estimate.light)
    assert np.array_equal(again.seen, estimate.seen)
    assert again.residual == estimate.residual
    assert [entry.name for entry in tmp_path.iterdir()] == ["actor.npz"]


def test_files_that_are_no_appearance_are_refused(scene, estimate, tmp_path):
    head = scene[0]
    with pytest.raises(InputError, match="no appearance"):
        load_appearance(tmp_path / "missing.npz", head)
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 not a zip")
    with pytest.raises(InputError, match="damaged"):
        load_appearance(tmp_path / "broken.npz", head)
    with pytest.raises(InputError, match=r"\.npz"):
        estimate.save(tmp_path / "actor.txt")
    replace(estimate, albedo=estimate.albedo[:-1], seen=estimate.seen[:-1]).save(tmp_path / "other.npz")
    replace(estimate, light=np.full_like(estimate.light, np.nan)).save(tmp_path / "dark.npz")
    with pytest.raises(InputError, match="light holds something other than finite numbers"):
        load_appearance(tmp_path / "dark.npz", head)
    for part, value in {"albedo": np.float32(0.5), "light": estimate.light[:4], "seen": estimate.seen[:-1]}.items():
        np.savez(tmp_path / "shapes.npz", **{**vars(estimate), part: value})
        with pytest.raises(InputError, match=r"damaged or of another kind.*have the shapes"):
            load_appearance(tmp_path / "shapes.npz", head)
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(InputError, match="pipe or device"):
        load_appearance(tmp_path / "pipe.npz", head)
    with pytest.raises(InputError, match="vertices"):
        load_appearance(tmp_path / "other.npz", head)


def test_pictures_that_do_not_show_the_face_are_refused(scene):
    head, _, vertices, camera, _, picture = scene
    with pytest.raises(InputError, match="pixels"):
        estimate_appearance(picture, head, vertices + np.array([5000.0, 0.0, 0.0]), camera)
    with pytest.raises(InputError, match="RGB"):
        estimate_appearance(picture[..., 0], head, vertices, camera)
    with pytest.raises(InputError, match="finite"):
        estimate_appearance(picture, head, vertices * np.nan, camera)
