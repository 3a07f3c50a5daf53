"""Gaze from pictures to the fit: the eye network as it runs, crops of single eyes, and rendered eyes that turn."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from workbench.config import preset
from workbench.errors import ModelError
from workbench.face import GAZE_NAMES, gaze_deg, in_scheme, load_default_head
from workbench.face.gaze import angle_between_deg
from workbench.landmarks.alignment import MEAN_SHAPE
from workbench.landmarks.detectors import make_detector
from workbench.landmarks.eyes import CORNERS, IRISES, LEAST_OPEN, EyeDetector, bundled_eye_network, eye_crop, eye_frame
from workbench.landmarks.schemes import DENSE
from workbench.networks.encoder import BLOCKS, WIDTHS
from workbench.networks.eye_network import (
    NAME,
    POINTS,
    SIDE,
    EyeNetwork,
    empty_eye_network,
    eye_places,
    read_eye_network,
)
from workbench.networks.frozen import FrozenEyeNetwork
from workbench.networks.weights import ARCHITECTURE, save_module
from workbench.pictures.gl_probe import gl_available
from workbench.tracker import FaceTracker
from workbench.tracking import FrameObservation

FRAMES = 26
"""Of a film: three glances and a blink."""
OPPOSITE = (("eyeLookUp", "eyeLookDown"), ("eyeLookIn", "eyeLookOut"))


@pytest.fixture(scope="module")
def network() -> EyeNetwork:
    """Small, with every weight drawn, so that no layer can be left out unseen."""
    leaves, structure = jax.tree.flatten(empty_eye_network((4, 6, 8, 10), 2, 3, 5, calibrated=True))
    rng = np.random.default_rng(1)
    drawn = [jnp.asarray(np.abs(rng.normal(0, 0.3, leaf.shape)), jnp.float32) for leaf in leaves]
    return jax.tree.unflatten(structure, drawn)


class TestNetwork:
    def test_the_frozen_network_says_what_the_network_says(self, network):
        picture = np.random.default_rng(2).integers(0, 256, (SIDE, SIDE, 3), dtype=np.uint8)
        expected = network(jnp.moveaxis(jnp.asarray(picture), -1, 0).astype(jnp.float32) / 255)
        found = FrozenEyeNetwork(network)(picture)
        assert found.points.shape == (POINTS, 2)
        for ours, theirs in zip(found, expected, strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4 * float(np.abs(theirs).max()))

    def test_the_last_number_is_the_odds_of_an_open_eye(self):
        numbers = np.zeros(5 * POINTS + 1)
        assert eye_places(numbers).is_open == 0.5
        numbers[-1] = np.log(9.0)
        assert eye_places(numbers).is_open == pytest.approx(0.9)

    def test_a_file_gives_the_network_back_and_another_network_is_refused(self, network, tmp_path):
        size = {WIDTHS: json.dumps([4, 6, 8, 10]), BLOCKS: "2"}
        save_module(tmp_path / "eyes.safetensors", network, {**size, ARCHITECTURE: NAME})
        read = read_eye_network(tmp_path / "eyes.safetensors")
        assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(read), jax.tree.leaves(network), strict=True))
        save_module(tmp_path / "other.safetensors", network, {**size, ARCHITECTURE: "another"})
        with pytest.raises(ModelError, match="should hold the weights of face-energy-eye-1, but its metadata names"):
            read_eye_network(tmp_path / "other.safetensors")


def _saying(odds: float) -> EyeNetwork:
    """The bundled network, whose eyes are all as likely open."""
    network = bundled_eye_network()
    head = replace(network.head, weight=network.head.weight.at[-1].set(0.0), bias=network.head.bias.at[-1].set(odds))
    return replace(network, head=head)


class TestCrops:
    def test_an_eye_lies_upright_in_the_middle_of_its_crop_three_fifths_wide(self):
        angle = np.radians(25.0)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        points = 200.0 * MEAN_SHAPE @ turn.T + 400.0
        for eye, (outer, inner) in enumerate(CORNERS):
            corners = eye_frame(points, eye).to_face(points[[outer, inner]])
            np.testing.assert_allclose(corners.mean(axis=0), (SIDE - 1) / 2, atol=1e-6)
            assert abs(corners[1, 0] - corners[0, 0]) == pytest.approx(0.6 * SIDE, rel=0.03)
            assert abs(corners[1, 1] - corners[0, 1]) < 1.0

    def test_a_mirrored_face_has_the_eyes_of_the_other_side(self):
        """What the network sees of the left eye is what it sees of the right one in the mirror, and so it answers."""
        rng = np.random.default_rng(0)
        picture = rng.integers(0, 256, (401, 401, 3), dtype=np.uint8)
        points = 300.0 * MEAN_SHAPE + 200.0  # symmetric: its mirror image has the same landmarks
        left = eye_crop(picture, eye_frame(points, 1), 1).astype(int)
        right = eye_crop(np.ascontiguousarray(picture[:, ::-1]), eye_frame(points, 0), 0).astype(int)
        assert np.abs(left - right).max() <= 2
        detector = EyeDetector()
        seen, mirrored = detector.see(picture, points), detector.see(np.ascontiguousarray(picture[:, ::-1]), points)
        np.testing.assert_allclose(seen.points[1], mirrored.points[0] * [-1, 1] + [400, 0], atol=0.5)
        assert seen.is_open[1] == pytest.approx(mirrored.is_open[0], abs=0.02)
        np.testing.assert_allclose(seen.covariance[1], mirrored.covariance[0] * [[1, -1], [-1, 1]], rtol=0.05, atol=0.5)

    def test_a_shut_eye_tells_next_to_nothing(self):
        points, picture = 300.0 * MEAN_SHAPE + 200.0, np.full((401, 401, 3), 90, np.uint8)
        closed, opened = (EyeDetector(_saying(odds)).see(picture, points) for odds in (-30.0, 30.0))
        np.testing.assert_allclose(closed.covariance, opened.covariance / LEAST_OPEN**2, rtol=1e-6)
        np.testing.assert_array_equal(closed.points, opened.points)

    def test_the_points_are_the_schemes_pupils_and_irises(self):
        assert sorted(IRISES.ravel()) == sorted(DENSE.groups["irises"])
        assert [DENSE.point_names[eye[0]] for eye in IRISES] == ["right pupil", "left pupil"]
        assert set(IRISES[1]) == {DENSE.mirror[point] for point in IRISES[0]}


@pytest.fixture(scope="module")
def film():
    """Somebody whom no network has seen, in fair light, looks around and blinks."""
    if not gl_available():
        pytest.skip("VTK finds no OpenGL here")
    return film_of(14)


def film_of(seed):
    from workbench.training.gaze_films import FILM_VIEW, gaze_films
    from workbench.training.scenes import FaceStudio
    from workbench.training.skin import skin_painter

    full = load_default_head(gaze=True)
    studio = FaceStudio(full, skin_painter(full), FILM_VIEW)
    (made,) = gaze_films(studio, glasses=False, count=1, frames=FRAMES, seed=seed)
    studio.close()
    return made


@pytest.fixture(scope="module")
def observed(film):
    return seen_by("dense", film)


def seen_by(name, film):
    """The film's landmarks as a detector sees them from frame to frame."""
    detector = make_detector(name)
    box = detector.detect_faces(film.frames[0].picture, "quick")[0].box
    points, seen = detector.align(film.frames[0].picture, box).points, []
    for number, frame in enumerate(film.frames):
        landmarks = detector.refine(frame.picture, points)
        points = landmarks.points
        seen.append(FrameObservation(number, landmarks, landmarks.image_size))
    return seen


def fitted(film, observed, weights, name="dense"):
    """The gaze of each frame's fit, and the fits."""
    head = in_scheme(load_default_head(), observed[0].landmarks.scheme)
    config = preset(name).changed(camera={"fov_deg": film.fov_deg}, identity={"frames": 4}, weights=weights)
    fits = list(FaceTracker(head, config).fit_all(observed))
    person = head.personal(fits[0].identity)
    return np.stack([gaze_deg(person, fit.expression) for fit in fits]), fits


def errors_and_those_of_still_eyes(film, gaze, fits):
    """Mean errors of the gaze in frames with open eyes: of the fits, and of the same eyes if they never turned."""
    true, is_open = np.stack([f.gaze_deg for f in film.frames]), np.array([f.eyes_open for f in film.frames])
    head = in_scheme(load_default_head(), fits[0].scheme)
    still = np.array([name not in GAZE_NAMES for name in head.expression_names])
    unturned = np.stack([gaze_deg(head.personal(fit.identity), fit.expression * still) for fit in fits])
    return tuple(angle_between_deg(each, true)[is_open].mean() for each in (gaze, unturned))


class TestFilm:
    @pytest.mark.long
    def test_fitted_eyes_look_where_the_true_ones_do_and_far_better_than_eyes_that_never_turn(self, film, observed):
        off, idle = errors_and_those_of_still_eyes(film, *fitted(film, observed, {}))
        assert off < 5.0
        assert off < 0.5 * idle

    @pytest.mark.long
    def test_two_pupils_beside_the_68_say_as_much(self, film):
        """Of two people: how well the 68 lie on one is chance."""
        films = (film, film_of(16))
        seen = [seen_by("network+pupils", each) for each in films]
        off, idle = np.mean([
            errors_and_those_of_still_eyes(each, *fitted(each, points, {}, "gaze"))
            for each, points in zip(films, seen, strict=True)
        ], axis=0)  # fmt: skip
        assert off < 5.0
        assert off < 0.5 * idle
        observed = seen[0]
        unseen = [
            replace(o, landmarks=replace(o.landmarks, confidence=np.r_[o.landmarks.confidence[:68], 0.0, 0.0]))
            for o in observed
        ]
        held, _ = fitted(film, unseen, {}, "gaze")
        assert angle_between_deg(held[1:], held[:-1]).mean() < 0.5

    @pytest.mark.long
    def test_shut_eyes_hold_their_last_gaze(self, film, observed):
        gaze, _ = fitted(film, observed, {})
        free, _ = fitted(film, observed, {"gaze": 0.0})
        shut = np.flatnonzero([not frame.eyes_open for frame in film.frames])
        drift, let_go = (angle_between_deg(each[shut[1:]], each[shut[:-1]]).max() for each in (gaze, free))
        assert drift < 3.0
        assert drift < let_go

    def test_no_eye_is_turned_two_ways_at_once(self, film, observed):
        names = in_scheme(load_default_head(), DENSE).expression_names
        pairs = [[names.index(way + side) for way in ways] for side in ("Left", "Right") for ways in OPPOSITE]
        held, free = (
            np.array([[min(fit.expression[pair]) for pair in pairs] for fit in fitted(film, observed, weights)[1]])
            for weights in ({}, {"opposites": 0.0})
        )
        assert held.max() < 0.05
        assert held.mean() < 0.5 * free.mean()

    def test_vergence_makes_both_eyes_look_the_same_way(self, film, observed):
        apart = [
            np.abs(gaze[:, 1] - gaze[:, 0]).mean()
            for gaze in (fitted(film, observed, {"vergence": omega})[0] for omega in (0.0, 10.0))
        ]
        assert apart[1] < apart[0]
