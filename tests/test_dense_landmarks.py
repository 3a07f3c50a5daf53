"""Landmark schemes, and the dense one from the detector to the track, the panel's views and the diagnosis."""

import json
from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from workbench.config import preset
from workbench.diagnosis import indistinguishable_groups
from workbench.energies.reprojection import Observation, landmark_errors, reprojection_with_jacobian
from workbench.errors import ConfigError, InputError, ModelError
from workbench.face import (
    GAZE_NAMES,
    FaceParameters,
    contour_blend,
    gaze_deg,
    in_scheme,
    landmark_model,
    load_default_head,
    model_landmarks,
)
from workbench.face.model import Embedding
from workbench.frames import open_frames
from workbench.geometry import camera_from_fov
from workbench.landmarks.alignment import frame_from_points
from workbench.landmarks.dense_detector import LIDS, DenseDetector
from workbench.landmarks.detectors import make_detector
from workbench.landmarks.files import LandmarkRecord, read_landmark_file, write_landmark_file
from workbench.landmarks.observations import Landmarks2D, of_ibug68
from workbench.landmarks.scheme import GROUPS, IBUG68, MIRROR, outer_eye_distance
from workbench.landmarks.schemes import DENSE, SCHEMES, scheme_named, scheme_of_count
from workbench.landmarks.tracking import LandmarkTracker
from workbench.landmarks.uncertainty import CORNERS, ellipses
from workbench.networks.regression import covariance_of
from workbench.pictures import OverlayParts, draw_landmarks, draw_overlay
from workbench.pipeline import track
from workbench.planning import plan_of
from workbench.plots import close_up
from workbench.samples import sample
from workbench.session import FittedHead, TuningSession, material_of_photo, material_of_track
from workbench.tracker import FaceTracker
from workbench.tracking import FrameObservation, Track
from workbench.tracking.moments import Moment
from workbench.tracking.plan import whitening_of
from workbench.tracking.records import stack_fits
from workbench.tracking.reestimation import Reestimator
from workbench.widgets.landmark_tools import LandmarkTools
from workbench.widgets.overlay_view import OverlayView, point_groups
from workbench.widgets.timeline_view import ROWS, TimelineView, strip_rows
from workbench.widgets.waiting import Waiting

SIZE = (640, 480)
FRAMES = (40, 43)


@pytest.fixture(scope="module")
def head():
    return load_default_head()


@pytest.fixture(scope="module")
def dense_head(head):
    return in_scheme(head, DENSE)


@pytest.fixture(scope="module")
def pictures():
    frames = open_frames(sample("performance")).iterate(FRAMES[0])
    return [next(frames).picture for _ in range(2)]


@pytest.fixture(scope="module")
def detector():
    return make_detector("dense")


@pytest.fixture(scope="module")
def run(head, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dense")
    config = preset("dense").changed(identity={"window": 2, "frames": 2})
    return track(sample("performance"), folder, head, config, pictures=False, frames=FRAMES)


@pytest.fixture(scope="module")
def perfect(dense_head):
    """The neutral face seen without error, a pixel of deviation in every direction."""
    config = preset("dense").changed(identity={"calibrate": False})
    return FaceTracker(dense_head, config).fitter.neutral_observation(SIZE)


def renumbered(model):
    """The same surface with its vertices in another order: another mesh."""
    order = np.random.default_rng(1).permutation(len(model.neutral))
    back = np.argsort(order)

    def moved(embedding):
        return Embedding(back[embedding.vertices], embedding.barycentric)

    return replace(
        model,
        name="renumbered",
        neutral=model.neutral[order],
        triangles=back[model.triangles],
        expression_deltas=model.expression_deltas[:, order],
        identity_deltas=model.identity_deltas[:, order],
        landmarks=moved(model.landmarks),
        contour=moved(model.contour),
        colors=model.colors[order],
        jaw_weights=model.jaw_weights[order],
        mirror=back[model.mirror][order],
        regions={name: back[vertices] for name, vertices in model.regions.items()},
    )


class TestSchemes:
    @pytest.mark.parametrize("scheme", SCHEMES.values(), ids=lambda scheme: scheme.name)
    def test_every_scheme_begins_with_the_68(self, scheme):
        assert scheme.point_names[:68] == IBUG68.point_names
        assert scheme.mirror[:68] == MIRROR
        assert all(set(scheme.groups[name]) >= set(GROUPS[name]) for name in GROUPS)

    @pytest.mark.parametrize("scheme", SCHEMES.values(), ids=lambda scheme: scheme.name)
    def test_parts_share_no_point_and_have_all(self, scheme):
        points = [point for part in scheme.parts.values() for point in part]
        assert sorted(points) == list(range(len(scheme)))

    def test_mirroring_twice_is_nothing_and_swaps_the_sides(self):
        mirror = np.array(DENSE.mirror)
        assert np.array_equal(mirror[mirror], np.arange(len(DENSE)))
        assert set(mirror[list(DENSE.groups["right_eye"])]) == set(DENSE.groups["left_eye"])
        assert len(set(DENSE.point_names)) == len(DENSE)

    def test_a_scheme_is_known_by_its_count_and_its_name(self):
        assert scheme_of_count(377) is DENSE
        assert scheme_named("ibug68") is IBUG68
        with pytest.raises(InputError, match=r"68 points \(ibug68\), 70 points .* or 377 points \(dense\), got 100"):
            scheme_of_count(100)
        with pytest.raises(InputError, match=r"no landmark scheme 'cofw': the schemes are .*\+pupils, dense"):
            scheme_named("cofw")


class TestModel:
    def test_the_points_lie_where_their_names_say(self, dense_head):
        points = dense_head.landmarks.of(dense_head.neutral)
        assert (points[list(DENSE.groups["right_eye"]), 0] < 0).all()
        np.testing.assert_allclose(points[list(DENSE.mirror)][68:], points[68:] * [-1, 1, 1], atol=0.3)
        for pupil, iris in zip((68, 69), np.split(np.array(DENSE.groups["irises"])[2:], 2), strict=True):
            away = np.linalg.norm(points[iris] - points[pupil], axis=1)
            assert away.max() < 1.2 * away.min()
            assert 4.0 < away.mean() < 8.0

    def test_a_model_is_the_same_in_every_scheme_but_for_eyes_that_no_68_points_see(self, head, dense_head):
        full = load_default_head(gaze=True)
        assert dense_head.fingerprint() == full.fingerprint() == in_scheme(full, DENSE).fingerprint()
        assert dense_head.expression_names == full.expression_names
        assert dense_head.jaw_unit == head.jaw_unit
        back = in_scheme(dense_head, IBUG68)
        assert np.array_equal(back.landmarks.vertices, head.landmarks.vertices)
        assert in_scheme(head, IBUG68) is head
        assert landmark_model(head).gaze is None

    def test_other_blendshapes_keep_their_order_before_the_eyes(self, head):
        one = in_scheme(replace(head.with_expressions(("jawOpen",)), expression_names=("opening",)), DENSE)
        assert one.expression_names == ("opening", *GAZE_NAMES)
        assert (landmark_model(one).gaze[:, 0] == 0.0).all()

    def test_a_file_of_the_default_heads_mesh_need_not_name_its_parts(self, head, dense_head):
        plain = replace(head, name="mine", regions={}, joints={}, identity_joint_deltas={})
        made = in_scheme(plain, DENSE)
        assert np.array_equal(made.landmarks.vertices, dense_head.landmarks.vertices)
        assert made.expression_names == dense_head.expression_names
        assert landmark_model(made).gaze is None

    def test_the_eyes_turn_to_where_their_units_say(self, dense_head):
        turns = dict(zip(dense_head.expression_names, landmark_model(dense_head).gaze.T, strict=True))
        rest = gaze_deg(dense_head, np.zeros(52))
        for name, (eye, axis, sign) in {
            "eyeLookOutLeft": (1, 0, 1),
            "eyeLookInLeft": (1, 0, -1),
            "eyeLookInRight": (0, 0, 1),
            "eyeLookUpRight": (0, 1, 1),
            "eyeLookDownLeft": (1, 1, -1),
        }.items():
            looking = np.array([float(name == each) for each in dense_head.expression_names])
            moved = gaze_deg(dense_head, looking) - rest
            np.testing.assert_allclose(turns[name].reshape(2, 2), moved, atol=1e-9)
            assert sign * moved[eye, axis] > 9.0
            assert np.abs(np.delete(moved.ravel(), 2 * eye + axis)).max() < 0.5
        assert not turns["jawOpen"].any()

    def test_another_mesh_has_the_points_where_the_default_head_lies_on_it(self, head, dense_head):
        person = head.personal(np.random.default_rng(0).normal(0.0, 1.0, 50))
        other = in_scheme(renumbered(person), DENSE)
        away = np.linalg.norm(other.landmarks.of(other.neutral) - dense_head.landmarks.of(person.neutral), axis=1)
        assert away[:68].max() < 1e-9
        assert away[list(DENSE.groups["ears"])].mean() < 1.0
        assert np.delete(away, DENSE.groups["ears"]).mean() < 0.4
        moved = [
            each.landmarks.of(each.expression_deltas[each.expression_names.index("mouthSmileLeft")])
            for each in (other, dense_head)
        ]
        np.testing.assert_allclose(*moved, atol=1.0)

    def test_a_surface_that_is_no_face_is_refused(self, head):
        flat = replace(renumbered(head), name="mask", triangles=np.tile(head.triangles[:1], (len(head.triangles), 1)))
        with pytest.raises(ModelError, match="'dense' could not be placed on 'mask': the default head does not lie"):
            in_scheme(flat, DENSE)


class TestWhitening:
    def test_it_takes_the_covariance_to_the_identity(self):
        rng = np.random.default_rng(0)
        root = rng.normal(size=(20, 2, 2))
        covariance = root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(2)
        whitening = whitening_of(covariance)
        assert (whitening[:, 1, 0] == 0).all()
        np.testing.assert_allclose(whitening @ covariance @ np.swapaxes(whitening, 1, 2), [np.eye(2)] * 20, atol=1e-9)
        np.testing.assert_allclose(covariance_of(whitening), covariance, rtol=1e-9)

    def test_residual_and_derivative_are_those_of_whitened_errors(self, dense_head):
        rng = np.random.default_rng(1)
        model = landmark_model(dense_head)
        points = model_landmarks(model, contour_blend(model.contour_yaw, 0.0, 1.0), jnp.zeros(50))
        camera = camera_from_fov(SIZE, 40.0)
        at = FaceParameters(
            jnp.array([0.1, 0.2, 0.05]), jnp.array([5.0, -3.0, 600.0]), jnp.full(52, 0.2), jnp.zeros(50)
        )
        root = rng.normal(size=(377, 2, 2))
        whitening = jnp.asarray(whitening_of(root @ np.swapaxes(root, 1, 2) + np.eye(2)))
        seen = Observation(jnp.asarray(rng.normal(300, 50, (377, 2))), jnp.ones(377), jnp.ones(()), whitening)
        free = ("rotation", "translation", "expression")

        def errors(*values):
            moved = at._replace(**dict(zip(free, values, strict=True)))
            return landmark_errors(camera, points, moved, seen).error.ravel()

        residual, jacobian = reprojection_with_jacobian(camera, points, at, seen, free)
        plain = landmark_errors(camera, points, at, seen._replace(whitening=None)).error
        np.testing.assert_allclose(residual.reshape(-1, 2), jnp.einsum("nij,nj->ni", whitening, plain), rtol=1e-9)
        unknown = tuple(getattr(at, name) for name in free)
        way = tuple(jnp.asarray(rng.normal(size=part.shape)) for part in unknown)
        _, slope = jax.jvp(errors, unknown, way)
        np.testing.assert_allclose(jacobian @ np.concatenate(way), slope, atol=1e-6)

    def test_a_point_that_is_sure_across_alone_pulls_across_alone(self, dense_head, perfect):
        """Shifted along its unsure direction a whole part is believed where the covariance says so, and not else."""
        eyes = np.array(DENSE.groups["mouth"])
        points, covariance = perfect.landmarks.points.copy(), perfect.landmarks.covariance.copy()
        points[eyes] += [0.0, 25.0]
        config = preset("dense").changed(identity={"calibrate": False})

        def moved(deviation_down):
            wide = covariance.copy()
            wide[eyes, 1, 1] = deviation_down**2
            landmarks = replace(perfect.landmarks, points=points, covariance=wide)
            fit = FaceTracker(dense_head, config).push(replace(perfect, landmarks=landmarks))[0]
            return np.linalg.norm((fit.projected - perfect.landmarks.points)[eyes], axis=1).mean()

        assert moved(500.0) < 0.1 * moved(1.0)

    def test_without_confidences_covariances_do_not_count_either(self, perfect):
        counts, whitening = plan_of(preset("face-it"), DENSE).measured(perfect.landmarks)
        assert whitening is None
        assert (counts == 1.0).all()

    def test_landmarks_of_another_scheme_than_the_models_are_refused(self, head, perfect):
        config = preset("dense").changed(identity={"calibrate": False})
        with pytest.raises(InputError, match="frame 0 are the 377 of 'dense', those of the face model the 68"):
            FaceTracker(head, config).push(perfect)

    def test_deep_energies_says_how_many_its_network_has(self):
        with pytest.raises(ConfigError, match=r'at the 68 points of its network.* the 377 .* deep\.network = "dense"'):
            plan_of(preset("deep"), DENSE)
        with pytest.raises(
            ConfigError, match=r'at the 377 points of its network.* the 68 .* landmarks\.detector = "dense"'
        ):
            plan_of(preset("deep").changed(deep={"network": "dense"}))


class TestRecords:
    def test_a_covariance_is_checked(self):
        good = np.tile(np.eye(2), (68, 1, 1))
        points = np.zeros((68, 2)) + np.arange(68)[:, None]
        assert Landmarks2D(points, np.ones(68), SIZE, good).covariance.shape == (68, 2, 2)
        with pytest.raises(InputError, match=r"covariance \(2, 2\) for each of 68 landmarks, got shape \(67, 2, 2\)"):
            Landmarks2D(points, np.ones(68), SIZE, good[:67])

    @pytest.mark.parametrize(
        "bad",
        [
            [[1.0, 2.0], [2.0, 1.0]],
            [[1.0, 2.0], [-2.0, 1.0]],
            [[8.02003928, 7.20077823], [7.20077823, 6.46520613]],
            [[1.0, np.nan], [np.nan, 1.0]],
            [[0.0, 0.0], [0.0, 1.0]],
        ],
        ids=["indefinite", "not symmetric", "singular but for rounding", "no number", "no variance"],
    )
    def test_a_covariance_that_cannot_whiten_is_refused(self, bad):
        covariance = np.tile(np.eye(2), (68, 1, 1))
        covariance[5] = bad
        points = np.zeros((68, 2)) + np.arange(68)[:, None]
        with pytest.raises(InputError, match=r"covariance of landmark 5 is .* symmetric and positive definite"):
            Landmarks2D(points, np.ones(68), SIZE, covariance)

    @pytest.mark.parametrize("suffix", [".csv", ".json"])
    def test_files_hold_all_points(self, suffix, perfect, tmp_path):
        records = [LandmarkRecord(0, "a", None, SIZE), LandmarkRecord(1, "b", perfect.landmarks, SIZE)]
        write_landmark_file(tmp_path / f"dense{suffix}", records)
        nobody, face = read_landmark_file(tmp_path / f"dense{suffix}")
        assert nobody.landmarks is None
        assert face.landmarks.scheme is DENSE
        np.testing.assert_allclose(face.landmarks.points, perfect.landmarks.points, atol=6e-4)

    def test_a_csv_holds_one_scheme(self, perfect, tmp_path):
        records = [
            LandmarkRecord(0, "a", perfect.landmarks, SIZE),
            LandmarkRecord(1, "b", of_ibug68(perfect.landmarks), SIZE),
        ]
        with pytest.raises(InputError, match="frame 1 has 68 points, the others 377: a CSV holds one scheme"):
            write_landmark_file(tmp_path / "mixed.csv", records)

    def test_a_pts_file_holds_the_68(self, perfect, tmp_path):
        write_landmark_file(tmp_path / "a.pts", [LandmarkRecord(0, "a", perfect.landmarks, SIZE)])
        assert next(read_landmark_file(tmp_path / "a.pts", SIZE)).landmarks.scheme is IBUG68


class TestEllipses:
    @pytest.mark.parametrize("share", [0.5, 0.8, 0.95])
    def test_an_ellipse_holds_its_share_of_the_distribution(self, share):
        covariance = np.array([[9.0, 4.0], [4.0, 3.0]])
        places = np.random.default_rng(0).multivariate_normal([50.0, 20.0], covariance, 4000)
        (outline,) = ellipses(np.array([[50.0, 20.0]]), covariance[None], share)
        inside = [cv2.pointPolygonTest(outline.astype(np.float32), place, False) > 0 for place in places.tolist()]
        assert np.mean(inside) == pytest.approx(share, abs=0.025)

    def test_pictures_show_them_where_the_detector_told_covariances(self, perfect):
        dark = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
        large = replace(perfect.landmarks, covariance=9.0 * perfect.landmarks.covariance)
        drawn, wider = (draw_landmarks(dark, found) for found in (perfect.landmarks, large))
        bare = draw_landmarks(dark, replace(perfect.landmarks, covariance=None))
        assert (wider > 0).sum() > 1.2 * (drawn > 0).sum() > 1.2 * (bare > 0).sum()

    def test_overlays_show_them_on_request_and_close_ups_enlarge_them(self, run, pictures):
        fit, parts = run.track[0], OverlayParts(ellipses=True)
        assert not np.array_equal(draw_overlay(pictures[0], fit, parts=parts), draw_overlay(pictures[0], fit))
        small, large = (close_up(pictures[0], fit, side)[1] for side in (200, 400))
        np.testing.assert_allclose(large.covariance, 4.0 * small.covariance, rtol=1e-9)
        filled = replace(fit, source="filled")
        assert np.array_equal(draw_overlay(pictures[0], filled, parts=parts), draw_overlay(pictures[0], filled))


class TestDetector:
    def test_it_answers_the_whole_face_about_the_network_detectors_points(self, detector, pictures):
        (face, *_) = detector.detect_faces(pictures[0], "quick")
        found = detector.align(pictures[0], face.box)
        heat = make_detector("network").align(pictures[0], face.box)
        assert found.scheme is DENSE
        np.testing.assert_allclose(found.points[:68], heat.points, atol=1e-6)
        lips = [np.array(DENSE.groups["mouth"])[part] for part in (slice(0, 20), slice(20, None))]
        middles = [found.points[points].mean(axis=0) for points in lips]
        assert np.linalg.norm(middles[0] - middles[1]) < 0.05 * outer_eye_distance(heat.points)
        spread = np.sqrt(np.linalg.det(found.covariance)) ** 0.5
        assert spread[list(DENSE.groups["ears"])].mean() > 1.5 * spread[list(DENSE.groups["nose"])].mean()

    def test_lids_of_a_shut_eye_are_the_surer(self, detector, pictures, monkeypatch):
        (face, *_) = detector.detect_faces(pictures[0], "quick")
        points = detector.align(pictures[0], face.box).points
        see = detector._eyes.see

        def deviations(right: float) -> np.ndarray:
            open_by = np.array([right, 1.0])
            monkeypatch.setattr(detector._eyes, "see", lambda *seen: see(*seen)._replace(is_open=open_by))
            return np.sqrt(np.linalg.det(detector.refine(pictures[0], points).covariance)) ** 0.5

        shut, half, wide = map(deviations, (0.0, 0.5, 1.0))
        np.testing.assert_allclose(shut[LIDS[0]] / wide[LIDS[0]], 0.6)
        np.testing.assert_allclose(half[LIDS[0]] / wide[LIDS[0]], 0.8)
        others = np.setdiff1d(np.arange(377), LIDS[0])
        np.testing.assert_allclose(shut[others], wide[others])

    def test_the_mirrored_picture_gives_the_mirrored_answer(self, detector, pictures):
        (face, *_) = detector.detect_faces(pictures[0], "quick")
        found = detector.align(pictures[0], face.box)
        width, order = pictures[0].shape[1], list(DENSE.mirror)
        left, top, right, bottom = face.box
        turned = detector.align(
            np.ascontiguousarray(pictures[0][:, ::-1]), (width - 1 - right, top, width - 1 - left, bottom)
        )
        mirrored = turned.points[order] * [-1, 1] + [width - 1, 0]
        np.testing.assert_allclose(mirrored[68:], found.points[68:], atol=1.0)
        across = turned.covariance[order][:, 0, 1]
        assert np.corrcoef(-across, found.covariance[:, 0, 1])[0, 1] > 0.9

    def test_a_video_keeps_the_covariances(self, detector, pictures):
        tracker = LandmarkTracker(detector)
        first, second = (tracker.step(picture) for picture in pictures)
        assert (first.source, second.source) == ("detected", "tracked")
        assert second.landmarks.covariance.shape == (377, 2, 2)
        again = LandmarkTracker(detector)
        again.restore(LandmarkTracker(detector).state(), None)
        state = tracker.state()
        again.restore(state, pictures[1])
        assert state["points"].shape == (377, 2)
        assert np.array_equal(again.step(pictures[0]).landmarks.points, tracker.step(pictures[0]).landmarks.points)

    def test_it_begins_where_the_68_of_it_say(self, detector, pictures):
        points = detector.refine(
            pictures[0], detector.align(pictures[0], detector.detect_faces(pictures[0], "quick")[0].box).points
        ).points
        assert np.array_equal(frame_from_points(points).matrix, frame_from_points(points[:68]).matrix)
        assert isinstance(detector, DenseDetector)


class TestRun:
    def test_the_track_says_its_scheme_and_keeps_covariances(self, run):
        assert run.track.meta["scheme"] == "dense"
        assert run.track.meta["format_version"] == 4
        fit = run.track[0]
        assert fit.scheme is DENSE
        assert fit.landmarks.covariance.shape == (377, 2, 2)
        assert fit.errors[1] < 5.0
        row = next(read_landmark_file(run.folder / "landmarks.csv"))
        assert row.landmarks.scheme is DENSE

    def test_reestimation_weighs_the_points_as_the_fit_did_and_keeps_their_covariances(self, run, dense_head):
        """A stage without the pose, from a finished fit and from a neutral expression: the fit's again."""
        fitted = run.track[1]
        config = preset("dense").changed(identity={"window": 2, "frames": 2})
        again = Reestimator(dense_head, plan_of(config, DENSE))
        for start in (fitted, replace(fitted, expression=np.zeros_like(fitted.expression))):
            found = again.fit(Moment(start, ()))
            np.testing.assert_array_equal(found.covariance, fitted.covariance)
            np.testing.assert_allclose(found.expression, fitted.expression, atol=0.02)

    def test_a_track_of_the_68_names_none(self, head, perfect, tmp_path):
        observation = replace(perfect, landmarks=of_ibug68(perfect.landmarks))
        config = preset("dense").changed(identity={"calibrate": False})
        (fit,) = FaceTracker(head, config).push(observation)
        Track(meta={"expression_names": [*head.expression_names]}, **stack_fits([fit])).save(tmp_path / "track.npz")
        stored = Track.load(tmp_path / "track.npz")
        assert "scheme" not in stored.meta
        assert stored.meta["format_version"] == 3
        assert stored.covariance.shape == (1, 0, 2, 2)

    def test_another_scheme_than_the_numbers_is_damage(self, run, tmp_path):
        with np.load(run.folder / "track.npz") as stored:
            arrays = dict(stored)
        meta = json.loads(arrays["meta"].item()) | {"scheme": "ibug68"}
        np.savez(tmp_path / "wrong.npz", **arrays | {"meta": np.array(json.dumps(meta))})
        with pytest.raises(InputError, match="damaged"):
            Track.load(tmp_path / "wrong.npz")

    def test_dense_points_tell_more_blendshapes_apart(self, head, dense_head):
        def groups(model):
            landmarks, names = landmark_model(model), model.expression_names
            points = model_landmarks(landmarks, np.eye(len(landmarks.contour_yaw))[0], np.zeros(50))
            frontal = FaceParameters(np.zeros(3), np.array([0.0, 0.0, 600.0]), np.zeros(len(names)), np.zeros(50))
            return indistinguishable_groups(points, camera_from_fov(SIZE, 40.0), [frontal], names).groups

        assert len(groups(dense_head)) < len(groups(head))

    @pytest.mark.long
    def test_a_session_fits_and_diagnoses_it(self, run, head):
        config = preset("dense").changed(identity={"window": 2, "frames": 2})
        session = TuningSession(head, material_of_track(run.track), config)
        assert np.array_equal(session.fit_clip().projected, run.track.projected)
        assert np.array_equal(session.diagnose(1).fit.projected, session.track[1].projected)
        assert np.isfinite(session.uncertainty(1).weights).all()
        with pytest.raises(ConfigError, match="choose a FACE IT! preset"):
            session.fit_frame(1, config=preset("deep"))

    def test_the_panel_offers_their_ellipses_and_draws_them_on_request(self, run, head, perfect):
        dense = TuningSession(head, material_of_track(run.track), preset("dense"))
        few = material_of_photo(np.zeros((SIZE[1], SIZE[0], 3), np.uint8), of_ibug68(perfect.landmarks))
        tools, plain = (
            LandmarkTools(session, FittedHead(session.model), print, Waiting(), lambda: None)
            for session in (dense, TuningSession(head, few))
        )
        assert [each.layers["ellipses"].layout.display for each in (tools, plain)] == [None, "none"]
        tools.show(run.track[0])
        assert tools.view._ellipses == b""
        tools.layers["ellipses"].value = True
        tools.show(run.track[0])
        drawn = np.frombuffer(tools.view._ellipses, np.float32).reshape(377, CORNERS, 2)
        np.testing.assert_allclose(drawn.mean(axis=1), run.track[0].observed, atol=1e-3)
        tools.show(replace(run.track[0], source="filled"))
        assert tools.view._ellipses == b""
        tools.close()
        plain.close()

    def test_a_frame_without_a_face_fits_among_the_others(self, dense_head):
        tracker = FaceTracker(dense_head, preset("dense").changed(identity={"calibrate": False}))
        (fit,) = tracker.push(FrameObservation(0, None, SIZE))
        assert fit.observed.shape == (377, 2)
        assert fit.covariance.shape == (377, 2, 2)
        assert fit.landmarks is None


class TestViews:
    def test_the_picture_shows_every_point_and_its_group(self, perfect):
        view = OverlayView(scheme=DENSE)
        view.set_fit(perfect.landmarks.points)
        assert len(view._fit) == 377 * 8 * 4
        assert len(view._scheme["names"]) == 377
        assert set(point_groups(DENSE)) >= {"irises", "pupils", "ears", "jaw", "right eye", "mouth"}

    @pytest.mark.parametrize("scheme", SCHEMES.values(), ids=lambda scheme: scheme.name)
    def test_the_strip_shows_the_points_of_every_scheme_in_as_many_rows(self, scheme):
        rows = [points for part in strip_rows(scheme).values() for points in part]
        assert len(rows) == ROWS
        assert all(len(points) for points in rows)
        assert sorted(np.concatenate(rows).tolist()) == list(range(len(scheme)))

    def test_the_strip_shows_the_worst_of_neighbours(self):
        values = np.zeros((2, 377), np.float32)
        values[1, 300] = 5.0
        view = TimelineView(scheme=DENSE)
        view.set_track(values)
        codes = np.frombuffer(view._packed()["codes"], np.uint8).reshape(2, ROWS)
        assert (codes[1] > 0).sum() == 1
        assert np.frombuffer(view._packed()["worst"], "<u2")[1] == 300
        with pytest.raises(InputError, match=r"shape \(frames, 377\); got \(2, 68\)"):
            view.set_track(np.zeros((2, 68)))
